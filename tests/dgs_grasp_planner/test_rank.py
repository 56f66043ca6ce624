"""Ranking: how likely a grasp holds, by its contacts and the way to it; what moves keeps the proposer's score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.propose.level_pinch import level_pinches
from dgs_grasp_planner.rank import AGAIN, ALIKE, DISTRUST, LEAST_SCORE, NEAR_BY, TURNED, rank
from dgs_grasp_planner.success import EVIDENCE, MOST, SuccessModel, evidence, success_model
from dgs_grasp_planner.way import BLOCKED, free_way
from tests.dgs_grasp_planner.contact.test_closing import bar, grasp
from tests.dgs_grasp_planner.contact.test_fit import BAR
from tests.dgs_grasp_planner.scenes import apart, field_of

NONE = np.zeros((0, 4, 4))


def test_a_hand_that_would_push_something_aside_on_its_way_comes_later() -> None:
    wall = np.random.default_rng(0).uniform((0.10, -0.07, 0.02), (0.14, 0.07, 0.13), (20_000, 3))
    turned = Rotation.from_euler("y", 35, degrees=True).as_matrix()
    straight = grasp(z=0.075, final=np.tile([0.0, 0.2, 0.2, 0.2], 5))[[0, 0]]
    hands = replace(straight, rotation=np.stack([turned @ straight.rotation[0], straight.rotation[0]]))
    field, alone = field_of(BAR, wall), field_of(BAR)
    beside, above = free_way(hands, field)
    assert above == 1.0 and beside == BLOCKED
    np.testing.assert_array_equal(free_way(hands, alone), [1.0, 1.0])
    assert evidence(hands, field)[:, EVIDENCE.index("free_way")].round(4).tolist() == [BLOCKED, 1.0]


def test_where_something_may_stand_is_no_free_way() -> None:
    field = field_of(BAR)
    hands = grasp(z=0.075, final=np.tile([0.0, 0.2, 0.2, 0.2], 5))[[0]]
    haunted = replace(field, feared=np.full_like(field.floors, 0.2))
    assert free_way(hands, haunted) == 1.0 and free_way(hands, haunted, feared=True) == BLOCKED
    assert rank(hands, haunted, NONE).score[0] == pytest.approx(BLOCKED * rank(hands, field, NONE).score[0])


def test_the_middle_of_a_stick_is_likelier_than_its_end_and_both_than_nothing() -> None:
    field = field_of(bar(half_width=0.012, height=0.025))
    pinches = fit(level_pinches(field), field)
    beside = replace(pinches, position=pinches.position + [0.3, 0.0, 0.0])
    ranked = rank(joined([beside, pinches]), field, NONE)
    assert abs(ranked.reference_point[0, 1]) < 0.01 and ranked.score[0] > 0.5
    assert (np.diff(ranked.score) <= 0).all() and ((ranked.score > 0) & (ranked.score < 1)).all()
    assert (ranked.score < LEAST_SCORE).sum() == len(beside)
    model = success_model()
    at_end = np.abs(pinches.reference_point[:, 1]) > 0.06
    likely = model(evidence(pinches, field))
    assert likely[at_end].max() < likely.max() - 0.05


def test_of_two_boxes_that_touch_each_is_judged_alone() -> None:
    rng = np.random.default_rng(4)
    box = rng.uniform((-0.03, -0.04, 0.0), (0.03, 0.04, 0.07), (30_000, 3))
    other = rng.uniform((-0.09, 0.041, 0.0), (0.09, 0.13, 0.035), (40_000, 3))
    hands = grasp(z=0.11, final=np.tile([0.0, 0.4, 0.4, 0.4], 5))
    alone, heap = field_of(box), apart(box, other)
    assert len(np.unique(heap.owner)) == 2
    offsets = [
        evidence(fit(hands, field), field.separated)[0, EVIDENCE.index("off_across")]
        for field in (alone, heap)
    ]
    np.testing.assert_allclose(*offsets, atol=0.01)
    np.testing.assert_allclose(*(rank(fit(hands, f), f, NONE).score[0] for f in (alone, heap)), rtol=0.25)
    assert evidence(fit(hands, heap), heap)[0, EVIDENCE.index("off_across")] > offsets[0] + 0.03


def test_evidence_says_where_and_what_is_held() -> None:
    stick = bar(half_width=0.012, height=0.025)
    field = field_of(stick)
    column = dict(zip(EVIDENCE, evidence(fit(level_pinches(field), field), field)[0], strict=True))
    assert column["enough"] == 1 and column["active"] == 4 and column["met"] >= 3
    assert (
        column["opposition"] > 0.7 and abs(column["off_across"]) < 0.01 and abs(column["off_along"]) < 0.005
    )
    assert abs(column["width"] - 0.024) < 0.006 and 0.02 < column["breadth"] < 0.05
    assert abs(column["top"] - 0.025) < 1e-6 and abs(column["length"] - np.ptp(stick[:, 1])) < 0.006
    assert abs(column["volume"] - 1e3 * 0.024 * 0.14 * 0.025) < 0.02


def test_with_a_motion_the_proposers_score_decides() -> None:
    two = replace(joined([grasp(), grasp()]), score=np.array([0.8, 0.9]))
    field = field_of(BAR)
    assert rank(replace(two, motion=two.motion + 0.01), field, NONE).score.tolist() == [0.9, 0.8]
    assert len(rank(GraspSet.empty(), field, NONE)) == 0
    moving = replace(two, motion=np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]))
    ranked = rank(moving, field, NONE)
    assert 0.9 in ranked.score and 0.8 not in ranked.score


def test_what_failed_is_tried_later_than_what_is_nearly_as_good() -> None:
    turned = Rotation.from_euler("z", 2 * TURNED).as_matrix()
    first, second, third, fourth = (grasp() for _ in range(4))
    second = replace(second, position=second.position + [2 * ALIKE, 0.0, 0.0])
    third = replace(third, position=third.position + [0.0, 0.5 * ALIKE, 0.0])
    fourth = replace(fourth, rotation=fourth.rotation @ turned)
    four, field = joined([first, second, third, fourth]), field_of(BAR)
    four = replace(four, score=np.array([0.9, 0.8, 0.7, 0.6]), motion=four.motion + 0.01)
    again = rank(four, field, first.pose)
    np.testing.assert_allclose(again.score, [0.8, 0.6, AGAIN * 0.9, AGAIN * 0.7])
    thrice = rank(four, field, np.concatenate([first.pose, first.pose, second.pose]))
    np.testing.assert_allclose(thrice.score, [0.6, AGAIN * 0.8, AGAIN**2 * 0.9, AGAIN**2 * 0.7])


def test_a_thing_that_a_grasp_failed_on_is_trusted_less_and_others_as_before() -> None:
    stick = bar(half_width=0.012, height=0.025)
    field = field_of(stick, stick + (0.07, 0.0, 0.0))
    pinches = fit(level_pinches(field), field)
    failed = np.eye(4)
    failed[:3, 3] = 0.0, 0.06, 0.04
    before, once = rank(pinches, field, NONE), rank(pinches, field, failed[None])
    twice = rank(pinches, field, np.stack([failed, failed]))

    def scores(grasps: GraspSet) -> tuple[np.ndarray, np.ndarray]:
        away = np.linalg.norm(grasps.position - failed[:3, 3], axis=1)
        at_it = (away < NEAR_BY) & (grasps.reference_point[:, 0] < 0.035)
        assert (away[~at_it] < NEAR_BY).any() and (grasps.reference_point[~at_it, 0] < 0.035).any()
        return np.sort(grasps.score[at_it]), np.sort(grasps.score[~at_it])

    for ranked, share in ((once, DISTRUST), (twice, DISTRUST**2)):
        for now, then, kept in zip(scores(ranked), scores(before), (share, 1.0), strict=True):
            assert len(now) and np.allclose(now, kept * then)


def test_the_formula_is_the_documented_one_and_far_values_are_cut() -> None:
    one = np.ones(1)
    model = SuccessModel(mean=2 * one, deviation=0.5 * one, linear=0.7 * one, square=-0.2 * one, bias=0.1)
    z = np.array([-1.0, 0.0, 3.0])
    expected = 1 / (1 + np.exp(-(0.1 + 0.7 * z - 0.2 * (z**2 - 1))))
    np.testing.assert_allclose(model((2 + 0.5 * z)[:, None]), expected)
    assert model(np.array([[1e6]])) == model(np.array([[2 + 0.5 * MOST]]))
    assert success_model().mean.shape == (len(EVIDENCE),)

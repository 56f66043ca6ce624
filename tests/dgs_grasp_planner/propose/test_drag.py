"""Drags: of what is low, narrow and lies towards the edge, in a pinch near its middle, until an end sticks out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.planner import GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.drag import Drag, drags
from dgs_grasp_planner.propose.edge_pinch import BALANCE, LEAST_OVERHANG
from dgs_grasp_planner.propose.level_pinch import LevelPinch
from dgs_grasp_planner.propose.push import PushSettings
from tests.dgs_grasp_planner.propose.test_edge_pinch import EDGE, case
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, table_scene

LENGTH, WIDTH = 0.2, 0.02


def knife(turn: float = 0.0, x: float = 0.0, height: float = 0.014) -> np.ndarray:
    """The seen top of a bar about (x, 0), turned [rad] from straight towards the edge."""
    along, across = np.meshgrid(np.arange(-LENGTH, LENGTH, 0.002) / 2, np.arange(-WIDTH, WIDTH, 0.002) / 2)
    cos, sin = np.cos(turn), np.sin(turn)
    points = np.stack([x + cos * along - sin * across, sin * along + cos * across], axis=-1).reshape(-1, 2)
    return np.column_stack([points, np.full(len(points), height)])


@pytest.mark.parametrize("turn", np.deg2rad([0.0, 45.0, -60.0]))
def test_an_end_of_a_knife_comes_out_over_the_edge_and_its_middle_does_not(turn: float) -> None:
    field = field_of(knife(turn))
    found = drags(field, EDGE)
    assert len(found) and (found.source == "drag").all() and found.drags.all() and not found.holds.any()
    best = found.best_first()[0]
    np.testing.assert_allclose(best.motion[1:], 0.0, atol=1e-12)
    after = knife(turn)[:, 0] + best.motion[0]
    assert after.min() < EDGE - LEAST_OVERHANG and after.mean() > EDGE + BALANCE - 0.002
    assert np.linalg.norm(best.position[:2]) < 0.04, "pinched near its middle"
    assert check(found[[0]], knife(turn), edge=EDGE).accepted.all()


def test_it_is_closed_onto_like_any_pinch_where_it_lies() -> None:
    field, found = field_of(knife()), drags(field_of(knife()), EDGE)[:1]
    fitted = fit(found, field)
    still = fit(replace(found, motion=np.zeros((1, 3)), drags=np.zeros(1, bool)), field)
    np.testing.assert_array_equal(fitted.grasp_joints, still.grasp_joints)
    np.testing.assert_array_equal(fitted.motion, found.motion)
    balls = HAND.end_balls(fitted.grasp_joints[0]) @ fitted.rotation[0].T + fitted.position[0]
    assert np.ptp(balls[fitted.active_fingers[0], 2]) < 0.002, "level"


def test_what_lies_along_the_edge_is_broad_or_sticks_out_is_not_dragged() -> None:
    assert not len(drags(field_of(knife(np.pi / 2)), EDGE))
    assert not len(drags(field_of(case(-0.05)), EDGE))
    assert not len(drags(field_of(knife() * (1.0, 3.5, 1.0)), EDGE)), "that can be pushed"
    assert not len(drags(field_of(knife(x=EDGE + 0.02)), EDGE))


def test_it_goes_around_what_lies_in_the_way_and_only_where_the_edge_is_free() -> None:
    block = knife(np.pi / 2, x=-0.17) * (1.0, 0.5, 4.0)
    in_the_hands_way = knife(x=-0.2, height=0.06) * (1.0, 0.5, 1.0) + (0.0, 0.035, 0.0)
    ways = [
        drags(field_of(np.concatenate([knife(), other])), EDGE).motion
        for other in (block, in_the_hands_way, block[:0])
    ]
    straight = [(np.abs(way[:, 1]) < 1e-9).any() for way in ways]
    assert len(ways[0]) and straight == [False, False, True]
    beside = drags(field_of(knife()), EDGE, PushSettings(free=(0.1, 0.3)))
    assert len(beside) and (beside.motion[:, 1] > 0.1).all() and (beside.motion[:, 1] < 0.3).all()


def test_a_doubtful_pinch_in_place_comes_after_the_drag() -> None:
    cloud = np.concatenate([table_scene(objects=0), knife(height=0.009).astype(np.float32)])
    planner = GraspPlanner([LevelPinch(), Drag()], PlannerSettings(edge=EDGE))
    grasps = planner(cloud, CAMERA, np.random.default_rng(0)).grasps
    sources = grasps.source.tolist()
    assert sources[0] == "drag" and "level_pinch" in sources
    nowhere = GraspPlanner([LevelPinch(), Drag()])(cloud, CAMERA, np.random.default_rng(0)).grasps
    assert "drag" not in nowhere.source

"""Level pinches: only for what is long and lies flat; both sides at one height, low enough, and just wide enough."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import closing_path, touch
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.contact.quality import NO_HOLD
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.propose.level_pinch import (
    BROADEST,
    CLEARANCE,
    ROOM,
    SPACING,
    LevelPinch,
    level_pinches,
)
from dgs_grasp_planner.scene import PlanRequest, Region
from dgs_grasp_planner.success import EVIDENCE, evidence
from tests.dgs_grasp_planner.contact.test_closing import bar
from tests.dgs_grasp_planner.scenes import CAMERA, apart, field_of, on_table, top

STICK = bar(half_width=0.010, height=0.020)


def in_table(grasps: GraspSet, points: np.ndarray) -> np.ndarray:
    """(K, P, 3) of (K, ..., 3) points of `hand_tcp`."""
    flat = points.reshape(len(grasps), -1, 3)
    return flat @ grasps.rotation.transpose(0, 2, 1) + grasps.position[:, None]


def test_both_sides_are_at_one_height_across_the_stick() -> None:
    grasps = level_pinches(field_of(STICK))
    assert len(grasps) >= 4 and len(grasps) % 2 == 0
    for joints, room in ((grasps.pre_grasp_joints, ROOM), (grasps.grasp_joints, 0.0)):
        balls = in_table(grasps, HAND.end_balls(joints)[:, :4])
        np.testing.assert_allclose(balls[..., 2], HAND.ball_radius + CLEARANCE, atol=0.001)
        across = (balls[:, 0] - balls[:, 1:].mean(axis=1))[:, 0]
        assert (across[0::2] * across[1::2] < 0).all(), "every place from both sides"
        np.testing.assert_allclose(np.abs(across), 2 * (0.010 + HAND.ball_radius + room), atol=0.004)
    np.testing.assert_allclose(grasps.reference_point[:, 2], 0.020, atol=0.001)
    assert (grasps.source == "level_pinch").all()
    assert (grasps.active_fingers == [True, True, True, True, False]).all()
    np.testing.assert_allclose(grasps.offset, grasps.position - grasps.reference_point)
    np.testing.assert_allclose(np.linalg.det(grasps.rotation), 1.0)


def test_a_stick_that_touches_something_high_is_pinched() -> None:
    beside = bar(half_width=0.04, height=0.09) + (0.0, 0.1415, 0.0)
    both = apart(STICK, beside)
    assert both.owner.max() == 1 and len(level_pinches(both.separated))


def test_the_middle_of_the_stick_comes_first_and_places_keep_apart() -> None:
    y = level_pinches(field_of(STICK)).reference_point[::2, 1]
    assert abs(y[0]) < SPACING and np.abs(y[0]) == np.abs(y).min()
    gaps = np.abs(y[:, None] - y[None])[~np.eye(len(y), dtype=bool)]
    assert gaps.min() > SPACING / 2


@pytest.mark.parametrize("degrees", [0, 35, 90, 130])
def test_the_stick_is_pinched_however_it_lies(degrees: float) -> None:
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    grasps = level_pinches(field_of(STICK @ turn.T))
    balls = in_table(grasps, HAND.end_balls(grasps.grasp_joints))
    line = (balls[:, 0] - balls[:, 1:3].mean(axis=1)) @ turn
    assert (np.abs(line[:, 0]) > 3 * np.abs(line[:, 1])).all()


def test_fitted_it_holds_the_stick_low_and_above_the_table() -> None:
    field = field_of(STICK)
    fitted = fit(level_pinches(field), field)
    best = fitted[[fitted.quality.argmax()]]
    assert best.quality[0] > 5 * NO_HOLD
    radii = np.tile(HAND.sphere_radii, 5)
    for joints in (best.pre_grasp_joints, best.grasp_joints):
        low = (in_table(best, HAND.finger_spheres(joints))[..., 2] - radii).min()
        assert -0.003 < low < 0.012
    path = closing_path(best)
    contact = touch(path, best.position[:, None], best.rotation, field_of(STICK), steps=21)
    assert contact.met[0, 0] and contact.met[0, 1:].sum() >= 2


@pytest.mark.parametrize(
    "cloud",
    [bar(0.010, height=0.060), bar(0.045, height=0.020), bar(0.039, height=0.030)],
    ids=["high", "a plate", "too wide"],
)
def test_what_is_high_or_wide_is_left_to_the_network(cloud: np.ndarray) -> None:
    assert not len(level_pinches(field_of(cloud)))


SOAP = top((-0.028, 0.028), (-0.033, 0.033), 0.024)


def test_a_broad_thing_is_pinched_across_its_middle_both_ways() -> None:
    grasps = level_pinches(field_of(SOAP))
    assert len(grasps) == 4, "across both edges, two ways round each"
    assert (np.linalg.norm(grasps.reference_point[:, :2], axis=1) < 0.003).all()
    balls = in_table(grasps, HAND.end_balls(grasps.grasp_joints)[:, :4])
    assert np.ptp(balls[..., 2], axis=1).max() < 0.005
    apart = np.linalg.norm((balls[:, 0] - balls[:, 1:].mean(axis=1))[:, :2], axis=1)
    np.testing.assert_allclose(sorted(apart - 2 * HAND.ball_radius), [0.056] * 2 + [0.066] * 2, atol=0.008)
    open_balls = in_table(grasps, HAND.end_balls(grasps.pre_grasp_joints)[:, :4])
    assert (open_balls[..., 2] > HAND.ball_radius - 0.004).all() and BROADEST < 0.088


@pytest.mark.parametrize("reach", [0.020, 0.045, 0.064, 0.080])
def test_hooks_and_things_that_touch_are_no_trouble(reach: float) -> None:
    field = field_of(
        top((-0.002, 0.002), (-0.059, 0.075), 0.025),
        top((-0.002, reach), (0.071, 0.075), 0.025),
        top((reach, reach + 0.059), (-0.008, 0.075), 0.025),
    )
    grasps = level_pinches(field)
    assert np.isfinite(grasps.position).all()
    assert (field.top(grasps.reference_point) > 0).all(), "on the thing, not in its gap"


@pytest.mark.parametrize("legs", [0.012, 0.020])
def test_a_hairpin_is_not_pinched_in_its_gap_nor_a_comb_by_its_teeth(legs: float) -> None:
    pin = [top((x - 0.003, x + 0.003), (-0.07, 0.07), 0.02) for x in (-legs, legs)]
    field = field_of(*pin, top((-legs, legs), (0.064, 0.07), 0.02))
    grasps = level_pinches(field)
    assert len(grasps) and (field.top(grasps.reference_point) > 0).all()
    teeth = [top((x - 0.006, x + 0.006), (-0.05, 0.06), 0.02) for x in (-0.046, 0.0, 0.046)]
    assert not len(level_pinches(field_of(*teeth, top((-0.046, 0.046), (0.045, 0.06), 0.02))))


PLIERS = (
    top((-0.008, 0.008), (-0.08, -0.02), 0.018),
    *(top((x - 0.006, x + 0.006), (-0.02, 0.09), 0.018) for x in (-0.018, 0.018)),
    top((-0.024, 0.024), (-0.03, -0.012), 0.018),
)
"""Jaws, and two handles 48 mm apart from outside to outside, 24 mm from inside to inside [m]."""


def test_what_is_forked_in_its_middle_is_pinched_from_outside_both_prongs() -> None:
    field = field_of(*PLIERS)
    grasps = level_pinches(field)
    balls = in_table(grasps, HAND.end_balls(grasps.grasp_joints)[:, :4])
    middle = (balls[:, 0] + balls[:, 1:].mean(axis=1))[:, :2] / 2
    outside = np.abs(balls[..., 0]).min(axis=1) > 0.024
    assert outside.sum() == 2, "from both sides"
    assert (np.linalg.norm(middle[outside] - field.centres[1], axis=1) < 0.006).all(), "where its mass is"
    assert (field.top(grasps.reference_point) > 0).all(), "seen on the thing, not in its gap"
    fitted = fit(grasps[outside], field)
    best = fitted[[fitted.quality.argmax()]]
    seen = dict(zip(EVIDENCE, evidence(best, field)[0], strict=True))
    assert best.quality[0] > 5 * NO_HOLD and seen["enough"]
    assert 0.0 < seen["depth"] < 0.018, "below the top of a prong"
    assert seen["length"] > 0.16 and seen["off_across"] < 0.01 and seen["offset"] < 0.01


def test_beside_something_high_a_fingertip_has_no_room() -> None:
    far, near = (field_of(STICK, top((x, x + 0.04), (-0.07, 0.07), 0.10)) for x in (0.060, 0.016))
    assert len(level_pinches(far)) and not len(level_pinches(near))


def test_only_what_is_wished_is_proposed() -> None:
    planner = GraspPlanner([LevelPinch()])

    def proposals(request: PlanRequest) -> int:
        return len(planner(on_table(STICK), CAMERA, np.random.default_rng(0), request).grasps)

    here = Region(transform(np.eye(3), (0.0, 0.0, 0.02)), np.full(3, 0.02))
    elsewhere = Region(transform(np.eye(3), (0.5, 0.0, 0.02)), np.full(3, 0.1))
    assert 0 < proposals(PlanRequest(region=here)) < proposals(PlanRequest())
    assert proposals(PlanRequest(region=elsewhere)) == proposals(PlanRequest(min_score=0.95)) == 0

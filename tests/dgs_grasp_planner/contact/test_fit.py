"""Fitting contacts: towards the object, onto its surface, with the quality of what the fingers meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.contact.quality import LIFT, NO_HOLD, sag
from dgs_grasp_planner.propose.level_pinch import level_pinches
from tests.dgs_grasp_planner.contact.test_closing import bar, grasp
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, table_scene
from tests.support.timing import fastest

HALF_WIDTH, HEIGHT = 0.015, 0.07
BAR = bar(HALF_WIDTH, HEIGHT)
FIELD = field_of(BAR)


def penetration(grasps: GraspSet) -> float:
    """How deep the first hand's fingers are in the bar, a box that stands on the table [m]."""
    world = HAND.finger_spheres(grasps.grasp_joints[0]) @ grasps.rotation[0].T + grasps.position[0]
    low, high = np.array([-HALF_WIDTH, -0.07, 0.0]), np.array([HALF_WIDTH, 0.07, HEIGHT])
    outside = np.linalg.norm(np.maximum(np.maximum(low - world, world - high), 0.0), axis=-1)
    inside = np.minimum(world - low, high - world).min(axis=-1)
    return float((HAND.sphere_radii - np.where(inside > 0, -inside, outside)).max())


@pytest.mark.parametrize("aside", [-0.010, 0.020])
def test_a_hand_beside_the_bar_is_moved_over_it(aside: float) -> None:
    refined = fit(grasp(x=aside), FIELD)
    assert abs(refined.position[0, 0]) < abs(aside) - 0.006
    np.testing.assert_allclose(refined.position, refined.reference_point + refined.offset)


def test_a_level_pinch_stays_level() -> None:
    """Moved along its own axis, a leaning hand would leave the height that the table dictates."""
    low = bar(0.012, 0.014)
    proposed = level_pinches(field_of(low))
    fitted = fit(proposed, field_of(low))
    assert (fitted.quality > NO_HOLD).sum() >= 4
    np.testing.assert_array_equal(fitted.position, proposed.position)
    balls = (
        HAND.end_balls(fitted.grasp_joints) @ fitted.rotation.transpose(0, 2, 1) + fitted.position[:, None]
    )
    held = fitted.quality > NO_HOLD
    assert np.abs(balls[held][:, :4, 2] - HAND.ball_radius).max() < 0.004


@pytest.mark.parametrize("other", [-0.004, 0.0, 0.008])
def test_what_has_another_width_than_it_was_taken_for_is_pinched_level(other: float) -> None:
    proposed = level_pinches(field_of(bar(0.012, 0.014)))
    fitted = fit(proposed, field_of(bar(0.012 + other / 2, 0.014)))
    fitted = fitted[fitted.quality > NO_HOLD]
    assert len(fitted)
    for joints in (fitted.pre_grasp_joints, fitted.grasp_joints):
        balls = HAND.end_balls(joints) @ fitted.rotation.transpose(0, 2, 1) + fitted.position[:, None]
        assert np.abs(balls[:, :4, 2] - HAND.ball_radius).max() < 0.0025


def test_the_final_hand_touches_and_does_not_cut() -> None:
    closed = grasp()
    assert penetration(closed) > 0.010
    assert penetration(fit(closed, FIELD)) < 0.003


def test_what_holds_nothing_keeps_its_shape() -> None:
    nowhere, there = grasp(x=0.3), grasp()
    fitted = fit(joined([nowhere, there]), FIELD)
    assert fitted.quality[0] == NO_HOLD and fitted.quality[1] > 0.5
    np.testing.assert_array_equal(fitted.grasp_joints[0], nowhere.grasp_joints[0])
    np.testing.assert_array_equal(fitted.position[0], nowhere.position[0])
    np.testing.assert_array_equal(fitted.score, [1.0, 1.0])


def test_across_the_bar_is_better_than_along_it() -> None:
    across = grasp()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    along = replace(across, rotation=turn @ across.rotation)
    fitted = fit(joined([along, across]), FIELD)
    assert fitted.quality[1] > fitted.quality[0] + 0.1


def test_what_is_held_by_its_side_hangs_unless_the_contact_next_to_its_middle_is_higher() -> None:
    across = np.array([[0.006, 0.0, rise] for rise in (0.0, 0.02, -0.01)] * 2)
    along = np.repeat([0.083, -0.083], 3)
    lacking = LIFT * 0.08
    wanted = [lacking, 0.0, lacking + 0.01, lacking, lacking + 0.02, lacking - 0.01]
    np.testing.assert_allclose(sag(across, along), wanted, atol=1e-9)
    assert not sag(across, np.full(6, 0.002)).any(), "the middle is between the contacts"


def test_a_hand_leans_until_what_it_holds_by_its_side_does_not_hang(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_grasp_planner.contact.fit.MOVES", np.zeros(1))
    rib, slab = bar(half_width=0.011), BAR[::2] * (8, 1, 0.3) + (0.12, 0, 0)
    field = field_of(rib, slab)  # one thing: the rib is too narrow to be another
    hand = grasp(z=0.075, final=np.tile([0.0, 0.2, 0.2, 0.2], 5))
    tilt = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    tilted = replace(hand, rotation=tilt @ hand.rotation)
    leaning, upright = fit(tilted, field), fit(hand, FIELD)
    monkeypatch.setattr("dgs_grasp_planner.contact.fit.LEANS", ())
    stiff = fit(tilted, field)
    turned = Rotation.from_matrix(tilted.rotation[0].T @ leaning.rotation[0]).as_rotvec()
    np.testing.assert_allclose(turned, [0.0, 0.175, 0.0], atol=1e-6)
    assert leaning.quality[0] > stiff.quality[0] + 0.1
    np.testing.assert_array_equal(upright.rotation, hand.rotation)


def test_nothing_to_fit_is_fine() -> None:
    assert len(fit(GraspSet.empty(), FIELD)) == 0


def test_the_pre_grasp_opens_as_wide_as_before() -> None:
    """A proposer that opens the hand by a little gets a hand that opens by a little."""

    def way(grasps: GraspSet) -> np.ndarray:
        return np.linalg.norm(
            HAND.fingertips(grasps.grasp_joints) - HAND.fingertips(grasps.pre_grasp_joints), axis=-1
        )

    wide, closed = grasp(), grasp().grasp_joints
    open_by = (HAND.pre_grasp(closed) - closed) * 0.0055 / way(wide).max()
    little = replace(wide, pre_grasp_joints=closed + open_by)
    fitted = fit(joined([wide, little]), FIELD)
    assert way(fitted)[0].max() > 0.012 and way(fitted)[1].max() <= 0.006 + 1e-9


def test_the_pre_grasp_stays_within_the_limits_and_idle_fingers_stay_where_they_are() -> None:
    nearly_open = np.tile([0.0, 0.15, 0.1, 0.1], 5)
    hand = replace(grasp(final=nearly_open), pre_grasp_joints=HAND.lower[None])
    idle = replace(grasp(), active_fingers=np.array([[True, True, True, True, False]]))
    fitted, rest = fit(hand, field_of(bar(0.04))), fit(idle, FIELD)
    assert fitted.quality[0] > NO_HOLD and (fitted.pre_grasp_joints >= HAND.lower - 1e-12).all()
    assert rest.quality[0] > NO_HOLD
    np.testing.assert_array_equal(rest.pre_grasp_joints[0, -4:], idle.grasp_joints[0, -4:])


def test_one_finger_holds_against_the_thumb_where_it_alone_takes_part_and_two_things_are_not_one() -> None:
    pair = replace(grasp(), active_fingers=np.array([[True, False, True, False, False]]))
    assert fit(pair, FIELD).quality[0] > NO_HOLD
    walls = [bar(0.002) + (side * (HALF_WIDTH - 0.002), 0.0, 0.0) for side in (-1, 1)]
    assert fit(grasp(), field_of(*walls)).quality[0] < fit(grasp(), FIELD).quality[0] - 0.2


def test_the_table_is_not_cut() -> None:
    def lowest(grasps: GraspSet) -> float:
        spheres = HAND.finger_spheres(np.stack([grasps.pre_grasp_joints[0], grasps.grasp_joints[0]]))
        return float(
            ((spheres @ grasps.rotation[0].T + grasps.position[0])[..., 2] - HAND.sphere_radii).min()
        )

    low = grasp(z=0.045)
    refined = fit(low, FIELD)
    assert lowest(low) < -0.008
    assert lowest(refined) > -0.005 and refined.quality[0] > 0.5


def test_it_is_fast_enough_for_a_scene() -> None:
    field, rng = field_of(table_scene(0), camera=CAMERA), np.random.default_rng(0)
    many = grasp()[np.zeros(32, dtype=int)]
    many = replace(many, position=many.position + rng.uniform(-0.1, 0.1, (32, 3)) * (1, 1, 0))
    assert fastest(lambda: fit(many, field)) < 0.2, "about 40 ms on an idle core"

"""Edge pinches: only of what sticks out far enough, from outside of the table, fingers beneath and clear of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.contact.things import CELL
from dgs_grasp_planner.propose.edge_pinch import BALANCE, LEAST_INSET, EdgePinch, edge_pinches
from dgs_grasp_planner.scene import Scene
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, top

EDGE = -0.25
THICK = 0.015
FRONT = -0.31


def case(front: float = FRONT, height: float = THICK, y: float = 0.0) -> np.ndarray:
    """The seen top of a flat case, 130 mm deep and 190 mm wide, whose front lies at x = `front`."""
    return top((front, front + 0.13), (-0.095, 0.095), height) + (0.0, y, 0.0)


def test_the_thumb_is_on_top_and_the_fingers_beneath_within_the_overhang() -> None:
    grasps = edge_pinches(field_of(case()), EDGE)
    assert len(grasps) >= 5 and (grasps.source == "edge_pinch").all() and grasps.holds.all()
    best = grasps.best_first()[0]
    assert abs(best.reference_point[1]) < 0.02, "the middle is tried first"
    np.testing.assert_allclose(best.motion[1:], 0.0, atol=1e-12)
    assert best.motion[0] > 0
    pose = best.closing_pose
    for joints in (best.pre_grasp_joints, best.grasp_joints):
        spheres = HAND.finger_spheres(joints) @ pose[:3, :3].T + pose[:3, 3]
        assert (spheres[0, -1, 2] - HAND.ball_radius) > THICK - 0.003
        assert (spheres[1:4, :, 2] + HAND.sphere_radii)[:, -3:].max() < 0.005, "beneath"
        assert (spheres[1:, :, 0] + HAND.sphere_radii).max() < EDGE, "clear of the table"
    balls = HAND.end_balls(best.grasp_joints) @ pose[:3, :3].T + pose[:3, 3]
    assert (balls[:4, 0] > FRONT + 0.02).all()
    start = HAND.finger_spheres(best.pre_grasp_joints) @ best.rotation.T + best.position
    assert (start[..., 0] + HAND.sphere_radii).max() < FRONT, "the approach ends outside of the thing"


@pytest.mark.parametrize(("height", "deep"), [(THICK, 0.045), (0.06, 0.04), (0.07, 0.025)])
def test_an_open_hand_takes_in_thick_things_without_pushing_them_back(height: float, deep: float) -> None:
    best = edge_pinches(field_of(case(height=height)), EDGE).best_first()[0]
    pose = best.closing_pose
    assert best.reference_point[0] - FRONT > deep - 0.003
    places = np.concatenate(
        [HAND.finger_spheres(best.pre_grasp_joints)[:4].reshape(-1, 3), HAND.palm_points()]
    )
    radii = np.zeros(len(places))
    radii[: 4 * len(HAND.sphere_radii)] = np.tile(HAND.sphere_radii, 4)
    places = places @ pose[:3, :3].T + pose[:3, 3]
    # Of the thing as it is seen, 130 mm deep from its front on.
    outside = np.maximum(np.stack([FRONT - places[:, 0], -places[:, 2], places[:, 2] - height], axis=1), 0.0)
    assert (np.linalg.norm(outside, axis=1) > radii - 0.002).all()


def test_what_has_holes_is_pinched_where_most_of_it_is() -> None:
    whole = case()
    x, y = whole[:, 0] - FRONT, whole[:, 1]
    frame = whole[(x < 0.02) | (x > 0.11) | (np.abs(y) > 0.075)]
    best, other = (edge_pinches(field_of(cloud), EDGE).best_first()[0] for cloud in (whole, frame))
    assert other.score < 0.7 * best.score
    one_sided = whole[(x < 0.02) | (y > 0.0)]
    assert edge_pinches(field_of(one_sided), EDGE).best_first()[0].reference_point[1] > 0.03


def test_turned_hands_are_proposed_too_and_rank_behind() -> None:
    grasps = edge_pinches(field_of(case()), EDGE)
    turned = np.abs(grasps.motion[:, 1]) > 0.01
    assert turned.any() and grasps.score[~turned].max() > grasps.score[turned].max()


@pytest.mark.parametrize(
    ("front", "height", "edge"),
    [(-0.275, THICK, EDGE), (FRONT, 0.09, EDGE), (-0.2, THICK, EDGE), (FRONT, THICK, None)],
)
def test_nothing_where_too_little_sticks_out_or_it_is_too_thick(
    front: float, height: float, edge: float | None
) -> None:
    scene = Scene(case(front, height).astype(np.float32), CAMERA, np.random.default_rng(0), edge=edge)
    assert not len(EdgePinch()(scene))


def test_the_stages_leave_them_as_they_are_and_the_check_knows_the_edge() -> None:
    cloud = case()
    field = field_of(cloud)
    grasps = edge_pinches(field, EDGE)
    fitted = fit(grasps, field)
    np.testing.assert_array_equal(fitted.position, grasps.position)
    np.testing.assert_array_equal(fitted.grasp_joints, grasps.grasp_joints)
    np.testing.assert_array_equal(fitted.quality, 1.0)
    accepted = check(fitted, cloud[::7], edge=EDGE)
    assert accepted.accepted.any() and (accepted.grasps.position == grasps.position).all()
    assert not check(fitted, cloud[::7]).accepted.any(), "a table everywhere is in the way"
    shifted = replace(fitted, position=fitted.position + [0.04, 0.0, 0.0])
    assert not check(shifted, cloud[::7], edge=EDGE).accepted.any()


def test_a_small_overhang_is_pinched_less_deep() -> None:
    deep, shallow = (edge_pinches(field_of(case(front)), EDGE).best_first()[0] for front in (FRONT, -0.291))
    inset = [g.reference_point[0] - front for g, front in ((deep, FRONT), (shallow, -0.291))]
    assert inset[0] > inset[1] >= LEAST_INSET - 0.004


def test_a_phone_that_lies_along_the_edge_is_pinched_where_its_middle_may_come_to_lie() -> None:
    phone = case(EDGE + BALANCE - 0.04 + 0.003, 0.01)
    phone = phone[(phone[:, 0] < phone[:, 0].min() + 0.08) & (np.abs(phone[:, 1]) < 0.08)]
    found = edge_pinches(field_of(phone), EDGE)
    assert len(found) and (EDGE - found.reference_point[:, 0] > 0.01).all()
    assert (found.reference_point[:, 0] - phone[:, 0].min() > LEAST_INSET - CELL / 2).all()

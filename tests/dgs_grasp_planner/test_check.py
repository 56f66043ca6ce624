"""Grasp checks against brute force and against situations with a known answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import OBJECT_HEIGHT, transform
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_description.pick import STAND_OFF
from dgs_grasp_planner.check import CLOUD_DEPTH, CLOUD_POINTS, TABLE_LIFT, Reason, check
from dgs_grasp_planner.scene import Region
from tests.dgs_grasp_planner.scenes import table_scene
from tests.support.timing import fastest

DOWN = np.diag([1.0, -1.0, -1.0])
OPEN = np.tile([0.0, 0.2, 0.1, 0.1], 5)
CLOSED = np.tile([0.0, 0.5, 0.6, 0.6], 5)


def grasp(
    position: tuple[float, float, float],
    rotation: np.ndarray = DOWN,
    joints: np.ndarray = OPEN,
    holds: bool = False,
) -> GraspSet:
    """One hand; if it shall hold nothing, nothing has to stand between its fingers."""
    return GraspSet.of(
        "test",
        position=position,
        rotation=rotation,
        pre_grasp_joints=joints,
        grasp_joints=CLOSED,
        active_fingers=holds,
        score=1.0,
        reference_point=position,
    )


def post(x: float, y: float, height: float, radius: float = 0.02) -> np.ndarray:
    """Points on a standing cylinder."""
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, 24), np.arange(0.01, height, 0.005))
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z], -1).reshape(-1, 3)


def reason(grasps: GraspSet, cloud: np.ndarray) -> Reason | None:
    return check(grasps, cloud).reasons[0]


NOTHING = np.zeros((0, 3))


def test_no_grasps() -> None:
    result = check(GraspSet.empty(), post(0, 0, 0.1))
    assert len(result.accepted) == 0 and result.counts() == {}


def test_table() -> None:
    assert reason(grasp((0, 0, 0.12)), NOTHING) is None
    assert reason(grasp((0, 0, 0.02)), NOTHING) == Reason.TABLE_AT_GRASP
    upwards = np.diag([1.0, 1.0, 1.0])
    # Palm up: free at the grasp, but it comes from below.
    assert reason(grasp((0, 0, 0.25), upwards), NOTHING) == Reason.TABLE_IN_APPROACH
    assert reason(grasp((0, 0, 0.40), upwards), NOTHING) is None


def test_a_little_too_low_is_lifted() -> None:
    free = grasp((0, 0, 0.5))
    shapes = np.concatenate([free.pre_grasp_joints, free.grasp_joints])
    lowest = float(((HAND.finger_spheres(shapes) @ DOWN.T)[..., 2] - HAND.sphere_radii).min())
    low = check(grasp((0, 0, -lowest - 0.010)), NOTHING)
    assert low.accepted[0]
    np.testing.assert_allclose(low.grasps.position[0, 2], -lowest, atol=1e-9)
    np.testing.assert_allclose(low.grasps.offset[0], [0, 0, 0.010], atol=1e-9)
    lower = grasp((0, 0, -lowest - TABLE_LIFT - 0.002))
    assert reason(lower, NOTHING) in (Reason.TABLE_AT_GRASP, Reason.TABLE_CLOSED)


def test_the_closed_shape_may_be_the_one_that_cuts_the_table() -> None:
    # Straight idle fingers that end up longer than the bent pre-grasp.
    bent = replace(
        grasp((0, 0, 0.5), joints=np.tile([0.0, 1.2, 1.0, 1.0], 5)), grasp_joints=np.zeros((1, 20))
    )
    closed = float((HAND.finger_spheres(np.zeros(20)) @ DOWN.T)[..., 2].min())
    low = replace(bent, position=np.array([[0.0, 0.0, -closed - 0.02]]))
    assert reason(low, NOTHING) == Reason.TABLE_CLOSED


def test_a_post_between_thumb_and_fingers_is_grasped_a_post_under_a_finger_is_not() -> None:
    at = grasp((0, 0, 0.10), holds=True)
    assert reason(at, post(0, 0, 0.10)) is None
    spheres = HAND.finger_spheres(OPEN)[1] @ DOWN.T + (0, 0, 0.10)
    x, y, _ = spheres[-1]
    assert reason(at, post(x, y, 0.12, 0.005)) == Reason.FINGERS_IN_CLOUD
    # A post that stands under the palm and is higher than the palm comes down.
    assert reason(at, post(-0.05, 0.0, 0.25, 0.005)) in (Reason.PALM_IN_CLOUD, Reason.FINGERS_IN_CLOUD)


def test_an_obstacle_that_only_the_approach_touches() -> None:
    sideways = Rotation.from_euler("y", 90, degrees=True).as_matrix()  # approach along +x
    at = grasp((0, 0, 0.25), sideways)
    palm_x = HAND.T_base_tcp[2, 3] - HAND.palm_boxes[:, 4].min()
    behind = np.array([[-palm_x - 0.05, 0.0, 0.25 + 0.05]]) + 0.001 * np.random.default_rng(0).normal(
        size=(40, 3)
    )
    assert reason(at, behind) == Reason.PALM_IN_CLOUD
    assert reason(at, behind - (STAND_OFF - 0.03, 0.0, 0.0)) is None


def test_points_of_the_table_are_no_obstacle() -> None:
    spheres = HAND.finger_spheres(OPEN).reshape(-1, 3) @ DOWN.T
    bottoms = spheres[:, 2] - HAND.all_radii
    at = grasp((0, 0, -float(bottoms.min())))
    beneath = np.tile(spheres[bottoms.argmin()], (10, 1)) * (1, 1, 0)
    for height, expected in ((OBJECT_HEIGHT, None), (OBJECT_HEIGHT + 1e-4, Reason.FINGERS_IN_CLOUD)):
        assert reason(at, beneath + (0, 0, height)) == expected


def test_nothing_between() -> None:
    at = grasp((0, 0, 0.12), holds=True)
    assert reason(at, NOTHING) == Reason.NOTHING_BETWEEN
    assert reason(at, post(0.25, 0.25, 0.1)) == Reason.NOTHING_BETWEEN


def test_cloud_checks_against_brute_force() -> None:
    """A point is in the hand if one of many small steps back along the approach puts it into a sphere or a box."""
    rng = np.random.default_rng(3)
    count = 16
    position = rng.uniform((-0.15, -0.3, 0.05), (0.15, 0.3, 0.2), (count, 3))
    tilt = Rotation.from_euler("zx", rng.uniform((0, -0.8), (2 * np.pi, 0.8), (count, 2))).as_matrix()
    grasps = joined([*(grasp(tuple(p), r @ DOWN) for p, r in zip(position, tilt, strict=True))])
    cloud = table_scene(2, points_per_object=300, table_points=10).astype(np.float64)
    result = check(grasps, cloud, edge=np.inf)
    high = cloud[cloud[:, 2] > OBJECT_HEIGHT]
    low = HAND.palm_boxes[:, 0::2] - HAND.T_base_tcp[:3, 3] + CLOUD_DEPTH
    up = HAND.palm_boxes[:, 1::2] - HAND.T_base_tcp[:3, 3] - CLOUD_DEPTH
    spheres, reach = HAND.finger_spheres(OPEN).reshape(-1, 3), HAND.all_radii - CLOUD_DEPTH
    wrong = 0
    for k in range(count):
        local = (high - position[k]) @ grasps.rotation[k]
        local = local[np.linalg.norm(local[:, :2], axis=1) < 0.15]
        fingers, palm = np.zeros(len(local), bool), np.zeros(len(local), bool)
        for back in np.linspace(0.0, STAND_OFF, 51):
            there = local + (0, 0, back)
            fingers |= (np.linalg.norm(there[:, None] - spheres, axis=2) < reach).any(1)
            palm |= ((there[:, None] > low) & (there[:, None] < up)).all(2).any(1)
        wanted = (
            Reason.FINGERS_IN_CLOUD
            if fingers.sum() > CLOUD_POINTS
            else Reason.PALM_IN_CLOUD
            if palm.sum() > CLOUD_POINTS
            else None
        )
        wrong += wanted != result.reasons[k]
    assert len({r for r in result.reasons}) >= 2, "the scene decides nothing"
    assert wrong <= 1, "one point may lie between two of the small steps"


def test_many_candidates_are_checked_quickly() -> None:
    spots = np.random.default_rng(0).uniform((-0.15, -0.3, 0.05), (0.15, 0.3, 0.15), (96, 3))
    grasps = joined([grasp(tuple(spot)) for spot in spots])
    cloud = table_scene(0, points_per_object=300, table_points=1500)
    assert fastest(lambda: check(grasps, cloud)) < 0.15  # 0.02 s on a quiet core


def test_many_boxes_to_keep_out_of_are_checked_quickly() -> None:
    rng = np.random.default_rng(0)
    grasps = joined(
        [grasp(tuple(spot)) for spot in rng.uniform((-0.15, -0.3, 0.05), (0.15, 0.3, 0.15), (96, 3))]
    )
    pushes = replace(grasps, motion=np.tile([0.6, 0.0, 0.0], (96, 1)))
    places = rng.uniform((-0.2, -0.4, 0.0), (0.2, 0.4, 0.3), (8, 3))
    boxes = [Region(transform(position=place), np.full(3, 0.1)) for place in places]
    assert fastest(lambda: check(pushes, NOTHING, keep_out=boxes)) < 0.8  # 0.1 s on a quiet core


def test_the_table_ends_at_its_edge() -> None:
    low = grasp((0, 0, 0.02))
    assert check(low, NOTHING, edge=-0.5).reasons[0] == Reason.TABLE_AT_GRASP
    assert check(low, NOTHING, edge=0.5).accepted[0]
    beside = grasp((-0.3, 0, 0.02))
    into = replace(beside, motion=np.array([[0.4, 0.0, 0.0]]))
    assert check(beside, NOTHING, edge=0.0).accepted[0]
    assert check(into, NOTHING, edge=0.0).reasons[0] == Reason.TABLE_AT_GRASP
    beneath = grasp((-0.2, 0.0, 0.13), Rotation.from_euler("y", 120, degrees=True).as_matrix() @ DOWN)
    assert check(beneath, NOTHING, edge=0.0).reasons[0] == Reason.TABLE_IN_APPROACH, (
        "the palm, not its corners"
    )


def test_a_motion_is_checked_and_a_push_is_to_touch() -> None:
    push, obstacle = grasp((0, 0, 0.12)), post(0.15, 0.0, 0.12)
    pushing = replace(push, motion=np.array([[0.3, 0.0, 0.0]]))
    assert reason(push, obstacle) is None and reason(pushing, obstacle) is None
    assert reason(replace(pushing, active_fingers=np.ones((1, 5), bool)), obstacle) == Reason.MOTION_IN_CLOUD
    assert check(pushing, obstacle, fixed=obstacle).reasons[0] == Reason.MOTION_IN_CLOUD
    above, beneath = grasp((0, 0, 0.30), holds=True), post(0, 0, 0.10)
    assert reason(above, beneath) == Reason.NOTHING_BETWEEN
    assert reason(replace(above, motion=np.array([[0.0, 0.0, -0.20]])), beneath) is None


@pytest.mark.parametrize("finger", range(HAND.finger_count))
def test_no_finger_enters_a_box_to_keep_out_of(finger: int) -> None:
    at = replace(grasp((0, 0, 0.12)), grasp_joints=OPEN[None])
    tip = HAND.finger_spheres(OPEN)[finger, -1] @ DOWN.T + (0, 0, 0.12)
    for side, expected in ((0.0, Reason.IN_KEEP_OUT), (0.03, None)):
        beside = tip + side * np.array([-1.0, 0.0, 0.0] if finger == 0 else [1.0, 0.0, 0.0])
        box = Region(transform(position=beside), np.array([0.02, 0.02, 0.02]))
        assert check(at, NOTHING, keep_out=[box]).reasons[0] == expected


def test_no_closed_finger_enters_a_box_to_keep_out_of() -> None:
    at = grasp((0, 0, 0.15))
    opened, closed = (HAND.finger_spheres(q).reshape(-1, 3) for q in (OPEN, CLOSED))
    away = (
        np.linalg.norm(closed[:, None] - opened, axis=-1).min(axis=1) - HAND.all_radii - HAND.all_radii.max()
    )
    place = closed[away.argmax()] @ DOWN.T + (0, 0, 0.15)
    box = Region(transform(position=place), np.full(3, 0.002))
    assert check(at, NOTHING, keep_out=[box]).reasons[0] == Reason.IN_KEEP_OUT
    straight = replace(at, grasp_joints=OPEN[None])
    assert check(straight, NOTHING, keep_out=[box]).reasons[0] is None


def test_what_is_pushed_does_not_pass_through_a_thin_box_between_two_looks() -> None:
    still = grasp((0, 0, 0.15))
    pushing = replace(still, motion=np.array([[0.3, 0.0, 0.0]]), reference_point=np.array([[0.2, 0.3, 0.02]]))
    for x in np.arange(0.25, 0.27, 0.002):
        wall = Region(transform(position=(x, 0.3, 0.0)), np.array([0.002, 0.2, 0.1]))
        assert check(pushing, NOTHING, keep_out=[wall]).reasons[0] == Reason.IN_KEEP_OUT


def test_neither_palm_nor_motion_nor_what_is_pushed_enters_a_box_to_keep_out_of() -> None:
    still = grasp((0, 0, 0.15))
    pushing = replace(still, motion=np.array([[0.3, 0.0, 0.0]]), reference_point=np.array([[0.2, 0.3, 0.02]]))
    holding = replace(pushing, active_fingers=np.ones((1, 5), bool))
    palm = HAND.palm_points().mean(axis=0) @ DOWN.T + (0, 0, 0.15)
    plate, ahead, beyond = (
        Region(transform(position=place), np.array([0.005, 0.4, size]))
        for place, size in ((palm, 0.01), ((0.25, 0.0, 0.2), 0.02), ((0.45, 0.3, 0.0), 0.1))
    )
    for grasps, box, expected in (
        (still, plate, Reason.IN_KEEP_OUT),
        (still, ahead, None),
        (pushing, ahead, Reason.IN_KEEP_OUT),
        (still, beyond, None),
        (pushing, beyond, Reason.IN_KEEP_OUT),
        (holding, beyond, Reason.NOTHING_BETWEEN),
    ):
        assert check(grasps, NOTHING, keep_out=[box]).reasons[0] == expected

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from dgs_arm_executor.ik import T_TCP_TOOL0, ArmIK
from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.planning_scene import (
    BESIDE,
    CARRIED,
    CLOUD,
    PlanningScene,
    SceneSettings,
    carried_shape,
    densify,
)
from dgs_arm_executor.robot_geometry import CHAIN, ENVIRONMENT, WHOLE_HAND, checked_pairs, load_robot_geometry
from dgs_arm_executor.self_filter import without_robot
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.urdf import urdf_path
from tests.support.grasps import top_grasp
from tests.support.picks import carried_box

OPEN = np.zeros(20)
DOWN = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def empty() -> PlanningScene:
    return PlanningScene()


def above(ik: ArmIK, x: float, y: float, z: float) -> np.ndarray:
    """Arm joints with the TCP at a place and the fingers down, on the branch that touches least."""
    found = ik.branches(transform(DOWN, (x, y, z)) @ T_TCP_TOOL0)[0]
    checker = PlanningScene().checker(OPEN)
    return min(found[np.isfinite(found[:, 0])], key=lambda q: len(checker.contacts(q)))


def block(x: float, y: float, height: float = 0.1, half: float = 0.02) -> np.ndarray:
    low, high = (x - half, y - half, CELL.table_height), (x + half, y + half, CELL.table_height + height)
    return np.random.default_rng(0).uniform(low, high, (4000, 3))


def test_points_far_off_and_beyond_all_measure_are_no_obstacles() -> None:
    near = block(0.2, -0.2)
    far = np.array([[1e9, 1e9, 1e9], [3e38, 0.0, 0.0], [0.0, -50.0, 1.0], [np.inf, 0.0, 0.0]])
    found = ObstacleCloud.from_points(np.concatenate([near, np.repeat(far, 3, axis=0)]))
    assert np.array_equal(found.points, ObstacleCloud.from_points(near).points) and len(found.points)


def test_finger_shapes_stand_where_the_whole_urdf_has_them() -> None:
    path = str(urdf_path("cell"))
    full = pin.buildModelFromUrdf(path)
    shapes = pin.buildGeomFromUrdf(full, path, pin.GeometryType.COLLISION)
    rng = np.random.default_rng(1)
    q_arm, q_hand = rng.uniform(-2, 2, 6), rng.uniform(HAND.lower, HAND.upper)
    q = np.zeros(full.nq)
    for name, value in zip((*ARM_JOINTS, *HAND.joints), (*q_arm, *q_hand), strict=True):
        q[full.joints[full.getJointId(name)].idx_q] = value
    expected, found = shapes.createData(), None
    pin.updateGeometryPlacements(full, full.createData(), shapes, expected, q)
    arm, shapes = load_robot_geometry().with_hand(q_hand)
    found = shapes.createData()
    pin.updateGeometryPlacements(arm, arm.createData(), shapes, found, q_arm)
    for a, b in zip(expected.oMg, found.oMg, strict=True):
        np.testing.assert_allclose(a.homogeneous, b.homogeneous, atol=1e-9)


def test_disabled_pairs_never_touch_and_the_others_are_checked(empty: PlanningScene) -> None:
    pairs = {frozenset(pair) for pair in checked_pairs(load_robot_geometry())}
    for a, b in (
        ("forearm_link", WHOLE_HAND),
        ("upper_arm_link", "wrist_2_link"),
        (WHOLE_HAND, "table"),
        (WHOLE_HAND, "bin"),
    ):
        assert frozenset((a, b)) in pairs
    for a, b in (("upper_arm_link", "forearm_link"), ("wrist_3_link", WHOLE_HAND)):
        assert frozenset((a, b)) not in pairs


def test_home_is_free_and_reported_contacts_are_the_real_ones(empty: PlanningScene, ik: ArmIK) -> None:
    checker = empty.checker(OPEN)
    assert not checker.in_collision(HOME_ARM) and checker.contacts(HOME_ARM) == []
    assert not checker.in_collision(above(ik, 0.3, 0.1, -0.1))
    low = above(ik, 0.3, 0.1, CELL.table_height + 0.03)
    assert checker.in_collision(low) and checker.contacts(low) == [(WHOLE_HAND, "table")]
    assert "hand meets table" in checker.describe(low)
    folded = np.array([0.0, -1.57, 3.0, 0.0, 0.0, 0.0])
    assert checker.in_collision(folded)
    x, y = CELL.bin_centre
    assert (WHOLE_HAND, "bin") in checker.contacts(above(ik, x + CELL.bin_size[0] / 2 + 0.05, y, -0.04))


@pytest.mark.parametrize("on_table", [False, True])
def test_the_quick_answer_is_that_of_looking_at_every_pair(on_table: bool) -> None:
    cloud = ObstacleCloud.from_points(np.concatenate([block(0.3, 0.1), block(0.25, -0.2)]))
    carried = carried_box((-0.03, -0.03, -0.05), (0.03, 0.03, 0.12))
    shape = np.tile([0.0, 0.5, 0.4, 0.4], 5)
    everywhere = SceneSettings((-9.0, -9.0, -9.0), (9.0, 9.0, 9.0))
    scene = PlanningScene(cloud, everywhere)
    checker = scene.checker(shape, carried=carried, hand_on_table=on_table)
    near_the_table = HOME_ARM + np.random.default_rng(2).uniform(-1.7, 1.7, (150, 6))
    answers = [checker.in_collision(q) for q in near_the_table]
    assert answers == [bool(checker.contacts(q)) for q in near_the_table]
    assert 0.1 < np.mean(answers) < 0.9


def test_the_hands_shape_counts(empty: PlanningScene, ik: ArmIK) -> None:
    q = above(ik, 0.3, 0.1, CELL.table_height + 0.05)
    fist = np.tile([0.0, 1.3, 1.0, 1.0], 5)
    assert empty.checker(OPEN).in_collision(q) and not empty.checker(fist).in_collision(q)


def test_clearance_of_the_closed_hand_forgives_touching_the_table_only(
    empty: PlanningScene, ik: ArmIK
) -> None:
    touching, through = (above(ik, 0.3, 0.1, CELL.table_height + 0.0628 + up) for up in (-0.005, -0.030))
    assert empty.checker(OPEN).in_collision(touching)
    closed = empty.checker(OPEN, hand_on_table=True)
    assert not closed.in_collision(touching) and closed.in_collision(through)


def test_cloud_and_released_target(ik: ArmIK) -> None:
    cloud = ObstacleCloud.from_points(np.concatenate([block(0.3, 0.1), block(0.3, -0.2)]))
    assert len(set(cloud.labels.tolist())) == 2
    scene = PlanningScene(cloud)
    q = above(ik, 0.3, 0.1, CELL.table_height + 0.10)
    grasp = np.tile([0.0, 0.3, 0.2, 0.2], 5)
    assert scene.checker(grasp).contacts(q) == [(WHOLE_HAND, CLOUD)]
    released = cloud.target_mask(top_grasp(0.3, 0.1, -0.1))
    assert released.any() and not released[cloud.points[:, 1] < 0].any()
    assert not scene.checker(grasp, released=released).in_collision(q)
    other = above(ik, 0.3, -0.2, CELL.table_height + 0.10)
    assert scene.checker(grasp, released=released).in_collision(other)
    assert not scene.checker(grasp, use_cloud=False).in_collision(other)


def test_small_pieces_beside_the_target_are_part_of_it() -> None:
    animal, foot, other = block(0.3, 0.1), block(0.3, 0.16, height=0.02, half=0.008), block(0.3, 0.25)
    cloud = ObstacleCloud.from_points(np.concatenate([animal, foot, other]))
    released = cloud.target_mask(top_grasp(0.3, 0.1, -0.1))
    assert (released == (cloud.points[:, 1] < 0.19)).all(), "all of the one, nothing of the other"
    assert (cloud.target_mask(top_grasp(0.3, 0.16, -0.18)) == released).all(), "whichever part is meant"
    away = ObstacleCloud.from_points(np.concatenate([animal, foot + (0.0, 0.04, 0.0)]))
    assert len(set(away.labels.tolist())) == 2, "too far away"


def test_what_is_as_low_as_the_table_has_no_voxels_and_takes_none_of_what_is_beside_it() -> None:
    thing = np.random.default_rng(0).uniform((0.25, 0.15, -0.2), (0.35, 0.25, -0.1), (3000, 3))
    cloud = ObstacleCloud.from_points(thing)
    beside = np.array([0.3, 0.08, CELL.table_height + 0.01])
    low = replace(top_grasp(0.3, 0.08, -0.17), reference_point=beside, motion=np.array([-0.3, 0.0, 0.0]))
    assert not cloud.target_mask(low).any() and not cloud.carried_mask(low).any()
    at_it = replace(low, reference_point=np.array([0.3, 0.2, CELL.table_height + 0.01]))
    assert cloud.target_mask(at_it).any(), "a thin part of what is higher elsewhere"


def test_the_noise_of_a_mat_is_in_the_way_of_other_things_but_not_of_the_mat() -> None:
    spots = np.array([(0.25, 0.05), (0.33, 0.1), (0.3, 0.2), (0.36, 0.17)])
    noise = np.concatenate([block(x, y, 0.013, half=0.003) for x, y in spots])
    cloud = ObstacleCloud.from_points(np.concatenate([noise, block(0.22, 0.13, 0.05)]))
    middle, way = np.array([0.3, 0.12, CELL.table_height + 0.009]), np.array([-0.2, 0.0, 0.0])
    push = replace(top_grasp(0.3, 0.12, -0.17), reference_point=middle, motion=way)
    released = cloud.points[cloud.target_mask(push)]
    assert len(released) > 0 and (released[:, 2] < CELL.table_height + 0.016).all()
    assert (np.linalg.norm(released[:, None, :2] - spots, axis=2).min(axis=0) < 0.01).all(), "all of it"
    higher = replace(push, reference_point=middle + (0.0, 0.0, 0.01))
    assert len(cloud.points[cloud.target_mask(higher)]) < len(released)


def test_cloud_drops_table_strays_and_nan() -> None:
    rng = np.random.default_rng(0)
    table = rng.uniform(
        (0.1, -0.4, CELL.table_height - 0.005), (0.5, 0.4, CELL.table_height + 0.008), (3000, 3)
    )
    strays = rng.uniform((0.1, -0.4, 0.0), (0.5, 0.4, 0.3), (20, 3))
    bad = np.full((5, 3), np.nan)
    cloud = ObstacleCloud.from_points(np.concatenate([table, strays, bad]))
    assert len(cloud.points) == 0 and cloud.octree() is None
    assert cloud.target_mask(top_grasp(0.0, 0.0, 0.0)).shape == (0,)


def test_what_is_in_the_bin_is_no_obstacle_and_a_heap_above_its_rim_is() -> None:
    x, y = CELL.bin_centre
    heap = block(x, y, height=CELL.bin_size[2] + 0.05)
    cloud = ObstacleCloud.from_points(heap)
    assert len(cloud.points) and (cloud.points[:, 2] > CELL.table_height + CELL.bin_size[2]).all()


def test_carried_object_is_part_of_the_robot(ik: ArmIK, empty: PlanningScene) -> None:
    x, y = CELL.bin_centre
    q = above(ik, x + CELL.bin_size[0] / 2, y, 0.05)
    assert not empty.checker(OPEN).in_collision(q)
    T_base_tcp = transform(DOWN, (0.3, 0.1, -0.1))
    seen = block(0.3, 0.1, height=0.02)
    box = CarriedBox.from_points(seen[seen[:, 2] > CELL.table_height + 0.015], T_base_tcp)
    assert box is not None and box.below_tcp == pytest.approx(0.1, abs=1e-6), "solid down to the table"
    long = carried_box((-0.03, -0.03, 0.0), (0.03, 0.03, 0.15))
    assert (CARRIED, "bin") in empty.checker(OPEN, carried=long).contacts(q)
    assert CarriedBox.from_points(np.zeros((0, 3)), T_base_tcp) is None
    other = ObstacleCloud.from_points(block(0.3, -0.2))
    high, all_of_it = above(ik, 0.3, -0.2, CELL.table_height + 0.25), np.ones(len(other.points), dtype=bool)
    low_end = carried_box((-0.03, -0.03, 0.0), (0.03, 0.03, 0.2))
    scene = PlanningScene(other)
    assert scene.checker(OPEN, carried=low_end).contacts(high) == [(CARRIED, BESIDE)]
    assert not scene.checker(OPEN, carried=low_end, own=all_of_it).in_collision(high)
    huge = empty.checker(OPEN, carried=carried_box(3 * [-0.6], 3 * [0.6])).contacts(HOME_ARM)
    assert {part for part in CHAIN if (CARRIED, part) in huge} == {*CHAIN[:4]}
    wire = carried_box((0.0, 0.0, 0.0), (0.0, 0.0, 0.15))
    model, _ = load_robot_geometry().with_hand(OPEN)
    np.testing.assert_allclose(2 * carried_shape(model, wire).geometry.halfSide, (0.01, 0.01, 0.15))


def test_the_box_of_what_is_carried_fits_a_flat_thing_however_the_hand_leans() -> None:
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    flat = np.random.default_rng(0).uniform((-0.1, -0.05, 0.01), (0.1, 0.05, 0.03), (5000, 3)) @ turned.T
    flat += (0.3, 0.1, CELL.table_height)
    leaning = transform(Rotation.from_euler("x", 120, degrees=True).as_matrix(), (0.3, 0.1, -0.1))
    box = CarriedBox.from_points(flat, leaning)
    assert box is not None and sorted(box.size) == pytest.approx([0.03, 0.1, 0.2], abs=0.002)
    assert box.holds(flat, leaning, 0.001).all()
    assert not box.holds(flat + (0.0, 0.0, 0.05), leaning, 0.001).any()


def test_all_of_a_large_thing_goes_where_its_target_goes_and_nothing_of_a_row_of_things() -> None:
    tray = np.random.default_rng(0).uniform((0.2, -0.1, 0.02), (0.4, 0.18, 0.03), (60_000, 3))
    tray += (0.0, 0.0, CELL.table_height)
    cloud, grasp = ObstacleCloud.from_points(tray), top_grasp(0.3, 0.1, -0.15)
    near = cloud.target_mask(grasp)
    assert not near.all() and cloud.carried_mask(grasp).all()
    row = ObstacleCloud.from_points(np.concatenate([tray, tray - (0.0, 0.28, 0.0)]))
    assert len(set(row.labels.tolist())) == 1
    assert (row.carried_mask(grasp) == row.target_mask(grasp)).all()


def test_paths_are_checked_in_between(ik: ArmIK, empty: PlanningScene) -> None:
    x, y = CELL.bin_centre
    checker = empty.checker(OPEN)
    a, b = above(ik, 0.3, 0.25, -0.12), above(ik, 0.3, -0.25, -0.12)
    assert checker.first_collision(np.stack([a, a])) is None
    over = above(ik, x, y, 0.1)
    inside = above(ik, x, y, -0.05)
    assert not checker.in_collision(over) and not checker.in_collision(inside)
    assert checker.first_collision(np.stack([inside, b])) is not None
    dense = densify(np.stack([a, b]), 0.03)
    assert np.abs(np.diff(dense, axis=0)).max() <= 0.03 + 1e-12


def test_self_filter_takes_out_the_robot_only(ik: ArmIK) -> None:
    q = above(ik, 0.3, 0.1, 0.0)
    beside = block(0.3, -0.2)
    tcp = np.array([0.3, 0.1, 0.0])
    palm = tcp + np.array([-0.05, 0.0, 0.1]) + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    kept = without_robot(np.concatenate([beside, palm]), q, OPEN)
    np.testing.assert_array_equal(kept, beside)
    held = tcp + np.random.default_rng(0).uniform((-0.02, -0.02, -0.3), (0.02, 0.02, -0.25), (50, 3))
    assert len(without_robot(held, q, OPEN)) == 50
    assert not len(without_robot(held, q, OPEN, carried_box((-0.03, -0.03, 0.0), (0.03, 0.03, 0.29))))


def test_self_filter_keeps_what_is_farther_than_two_centimetres_from_every_shape(ik: ArmIK) -> None:
    q = above(ik, 0.3, 0.1, 0.0)
    geometry = load_robot_geometry()
    arm, shapes = geometry.with_hand(OPEN)
    data = shapes.createData()
    pin.updateGeometryPlacements(arm, arm.createData(), shapes, data, q)
    points = np.random.default_rng(0).uniform((-0.2, -0.2, -0.1), (0.5, 0.25, 0.6), (1200, 3))
    dot, away = coal.Sphere(1e-6), np.full(len(points), np.inf)
    for part, shape, place in zip(geometry.parts, shapes.geometryObjects, data.oMg, strict=True):
        for k, point in enumerate(points if part not in ENVIRONMENT else ()):
            at = coal.Transform3s(np.eye(3), point), coal.Transform3s(place.rotation, place.translation)
            found = coal.distance(
                dot, at[0], shape.geometry, at[1], coal.DistanceRequest(), coal.DistanceResult()
            )
            away[k] = min(away[k], found)
    sure = np.abs(away - 0.02) > 1e-5
    assert np.count_nonzero((away > 0.0) & (away < 0.02)) > 20
    kept = {tuple(point) for point in without_robot(points, q, OPEN)}
    assert [tuple(point) in kept for point in points[sure]] == (away[sure] > 0.02).tolist()

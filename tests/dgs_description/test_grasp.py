"""GraspSet and Region under selection and motion."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.frames import inverse, transform
from dgs_description.grasp import NO_WISHES, GraspSet, PlanRequest, Region
from dgs_grasp_planner.network.decode import grasps_from_outputs


def _some(count: int) -> GraspSet:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(count, 12))
    return grasps_from_outputs(
        normal[:, :3],
        rng.random(count),
        normal[:, 3:9],
        normal[:, 9:],
        np.zeros((count, 15)),
        np.zeros((count, 15)),
    )


def test_moving_there_and_back() -> None:
    grasps = _some(5)
    T_a_b = transform(Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix(), (0.1, 0.2, -0.3))
    moved = grasps.moved(T_a_b)
    np.testing.assert_allclose(moved.position, moved.reference_point + moved.offset)
    poses = [T_a_b @ transform(r, p) for r, p in zip(grasps.rotation, grasps.position, strict=True)]
    np.testing.assert_allclose(moved.rotation, [pose[:3, :3] for pose in poses])
    np.testing.assert_allclose(moved.position, [pose[:3, 3] for pose in poses])
    back = moved.moved(inverse(T_a_b))
    np.testing.assert_allclose(back.position, grasps.position, atol=1e-12)
    np.testing.assert_allclose(back.rotation, grasps.rotation, atol=1e-12)


def test_selecting() -> None:
    grasps = _some(5)
    assert len(grasps) == 5 and len(GraspSet.empty()) == 0
    chosen = grasps.select([3, 1])
    np.testing.assert_array_equal(chosen.score, grasps.score[[3, 1]])
    assert len(grasps.select(grasps.score > 2)) == 0


def test_region_is_a_turned_box() -> None:
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    region = Region(transform(turn, (1.0, 0.0, 0.0)), np.array([2.0, 0.2, 0.2]))
    points = np.array([[1.0, 0, 0], [1.6, 0.6, 0], [1.6, -0.6, 0], [1.0, 0, 0.11], [1.8, 0.8, 0]])
    assert region.contains(points).tolist() == [True, True, False, False, False]


def test_joining_and_wishing() -> None:
    grasps = _some(5)
    both = grasps.select([0, 1]).joined(grasps.select([4]))
    np.testing.assert_array_equal(both.rotation, grasps.rotation[[0, 1, 4]])
    assert len(grasps.joined(GraspSet.empty())) == 5
    assert len(NO_WISHES.admitted(grasps)) == 5
    limit = float(np.median(grasps.score))
    assert (PlanRequest(min_score=limit).admitted(grasps).score >= limit).all()
    here = Region(transform(np.eye(3), grasps.reference_point[2]), np.full(3, 1e-3))
    np.testing.assert_array_equal(PlanRequest(region=here).admitted(grasps).position, grasps.position[[2]])

"""Wishes of a request, and what a scene makes of its cloud."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_grasp_planner.preprocess import CloudSettings
from dgs_grasp_planner.scene import VOXEL, PlanRequest, Region, prepare
from tests.dgs_description.test_grasp import _some as some
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene


def test_region_is_a_turned_box() -> None:
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    region = Region(transform(turn, (1.0, 0.0, 0.0)), np.array([2.0, 0.2, 0.2]))
    points = np.array([[1.0, 0, 0], [1.6, 0.6, 0], [1.6, -0.6, 0], [1.0, 0, 0.11], [1.8, 0.8, 0]])
    assert region.contains(points).tolist() == [True, True, False, False, False]


def test_what_is_wished_is_admitted() -> None:
    grasps = some(5)
    assert len(PlanRequest().admitted(grasps)) == 5
    limit = float(np.median(grasps.score))
    assert (PlanRequest(min_score=limit).admitted(grasps).score >= limit).all()
    here = Region(transform(np.eye(3), grasps.reference_point[2]), np.full(3, 1e-3))
    np.testing.assert_array_equal(PlanRequest(region=here).admitted(grasps).position, grasps.position[[2]])


def test_a_scene_keeps_points_near_objects_and_one_mean_per_voxel() -> None:
    cloud = table_scene(1)
    scene = prepare(cloud, CAMERA, np.random.default_rng(0), PlanRequest(), CloudSettings())
    assert len(scene.points) <= 20_000 and (scene.points[:, 2] > 0.01).any()
    high = scene.points[scene.points[:, 2] > scene.object_height]
    cells = np.unique(np.floor(high / VOXEL).astype(int), axis=0)
    assert len(scene.voxels) == len(cells)
    np.testing.assert_array_equal(
        np.unique(np.floor(scene.voxels / VOXEL).astype(int), axis=0), cells, "means lie in their cells"
    )
    assert scene.field is scene.field and scene.field is not None
    assert list(scene.clock.times) == ["prepare", "height_field"]

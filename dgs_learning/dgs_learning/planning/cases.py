"""Random cells for the measurement of the pick planner: objects, one depth image, and the grasps to choose from."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import apply
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.cell_planner import in_workspace, predict_in_cell
from dgs_grasp_planner.scene import Planner, PlanRequest
from dgs_perception.edges import cleaned
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import render
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.world import World, random_scene

FEWEST, MOST = 4, 6
"""Objects in a scene."""
CANDIDATES = 64
"""Most grasps that the arm's planner gets."""
MIN_SCORE = 0.3
"""Of the grasps: low, so that there are many; the planner of the arm shall have to choose."""


@dataclass(frozen=True)
class PickCase:
    """One cell to plan a pick in.

    Attributes:
        objects: what truly stands on the table, poses in `base_link`.
        cloud: (N, 3) float32 what the camera saw within the workspace, in `base_link` [m].
        grasps: the grasp planner's, in `base_link`, best first; none where it found none.
    """

    number: int
    objects: tuple[PlacedObject, ...]
    cloud: NDArray[np.float32]
    grasps: GraspSet


def make_case(number: int, seed: int, catalogue: Sequence[ObjectModel], planner: Planner) -> PickCase:
    """Scene `number` of a run, with objects of a catalogue; depends on seed and number alone.

    Raises:
        DgsError: the objects would not stay on the table.
    """
    rng = np.random.default_rng([seed, number])
    count = int(rng.integers(FEWEST, MOST + 1))
    objects = tuple(random_scene(catalogue, count, int(rng.integers(2**31))))
    cloud = observe(objects, rng)
    points = cloud.astype(np.float64)
    request = PlanRequest(max_grasps=CANDIDATES, min_score=MIN_SCORE)
    try:
        camera = CELL.T_base_camera_optical[:3, 3]
        grasps = predict_in_cell(planner, points, camera, number, request).grasps
        grasps = grasps[grasps.holds]
    except DgsError as error:
        if error.code not in (ErrorCode.NO_OBJECTS, ErrorCode.NO_GRASP):
            raise
        grasps = GraspSet.empty()
    return PickCase(number, objects, cloud[in_workspace(points, 0.0)], grasps)


def observe(objects: Sequence[PlacedObject], rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, 3) float32 points of a noisy depth image of the cell with the arm at home, in `base_link` [m]."""
    with closing(World(objects)) as world:
        stage = world.snapshot().stage
    depth = render(stage.meshes, stage.poses, D455, CELL.T_base_camera_optical).depth
    noisy = cleaned(D455Noise().apply(depth, D455, rng), D455)
    points = apply(CELL.T_base_camera_optical, D455.deproject(noisy).astype(np.float64))
    return points[np.isfinite(points).all(axis=1)].astype(np.float32)

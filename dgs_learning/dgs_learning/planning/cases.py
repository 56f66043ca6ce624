"""Random cells for the measurement of the pick planner: objects, one depth image, and the network's candidates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.pick_types import Candidate, candidates_of
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import CELL, apply
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.cell_planner import in_workspace
from dgs_grasp_planner.scene import Planner, PlanRequest
from dgs_learning.prediction.offline import predict_in_cell
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import render
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.world import World, random_scene

Array = NDArray[np.float64]

FEWEST, MOST = 4, 6
"""Objects in a scene."""
CANDIDATES = 64
"""Most candidates that the planner gets."""
MIN_SCORE = 0.3
"""Of the candidates: low, so that there are many; the planner of the arm shall have to choose."""


@dataclass(frozen=True)
class PickCase:
    """One cell to plan a pick in.

    Attributes:
        number: of the scene in its run.
        objects: what truly stands on the table, poses in `base_link`.
        cloud: (N, 3) float32 what the camera saw within the workspace, in `base_link` [m].
        candidates: the network's grasps, best first; none where it found none.
    """

    number: int
    objects: tuple[PlacedObject, ...]
    cloud: NDArray[np.float32]
    candidates: tuple[Candidate, ...]


def make_case(number: int, seed: int, catalogue: Sequence[ObjectModel], planner: Planner) -> PickCase:
    """Scene `number` of a run; depends on seed and number alone.

    Args:
        number: of the scene.
        seed: of the run.
        catalogue: objects to choose from.
        planner: the network's planner, in the frame *table*.

    Raises:
        DgsError: the objects would not stay on the table.
    """
    rng = np.random.default_rng([seed, number])
    count = int(rng.integers(FEWEST, MOST + 1))
    objects = tuple(random_scene(catalogue, count, int(rng.integers(2**31))))
    cloud = observe(objects, rng)
    try:
        answer = predict_in_cell(
            planner,
            cloud,
            CELL.T_base_camera_optical,
            number,
            PlanRequest(max_grasps=CANDIDATES, min_score=MIN_SCORE),
        )
        grasps = answer.prediction.grasps
    except DgsError as error:
        if error.code is not ErrorCode.NO_OBJECTS:
            raise
        grasps = GraspSet.empty()
    return PickCase(
        number,
        objects,
        cloud[in_workspace(cloud.astype(np.float64), 0.0)],
        candidates_of(
            grasps.position,
            grasps.rotation,
            grasps.pre_grasp_joints,
            grasps.grasp_joints,
            grasps.reference_point,
            grasps.score,
        ),
    )


def observe(objects: Sequence[PlacedObject], rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, 3) float32 points of a noisy depth image of the cell with the arm at home, in `base_link` [m]."""
    world = World(objects)
    try:
        snapshot = world.snapshot()
    finally:
        world.close()
    depth = render(snapshot.meshes, snapshot.poses, D455, CELL.T_base_camera_optical).depth
    noisy = D455Noise().apply(depth, D455, rng)
    points = apply(CELL.T_base_camera_optical, D455.deproject(noisy).astype(np.float64))
    return points[np.isfinite(points).all(axis=1)].astype(np.float32)

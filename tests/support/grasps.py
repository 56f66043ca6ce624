"""Grasps from above for the tests of the arm executor's core."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

DOWN = np.diag([1.0, -1.0, -1.0])
FINAL = np.tile([0.0, 0.55, 0.4, 0.4], 5)


def top_grasps(
    places: np.ndarray, tilt: float = 0.0, yaw: float = 0.0, final: np.ndarray = FINAL
) -> GraspSet:
    """Grasps with all fingers whose TCPs and reference points are the places (K, 3) in `base_link` [m]."""
    turn = Rotation.from_euler("z", yaw) * Rotation.from_euler("y", tilt)
    places = np.asarray(places, float).reshape(-1, 3)
    count = len(places)
    return GraspSet.of(
        "test",
        position=places,
        rotation=np.tile(turn.as_matrix() @ DOWN, (count, 1, 1)),
        pre_grasp_joints=np.tile(HAND.pre_grasp(final), (count, 1)),
        grasp_joints=np.tile(final, (count, 1)),
        active_fingers=np.ones(5, bool),
        score=np.linspace(0.9, 0.1, count),
        reference_point=places,
    )


def top_grasp(x: float, y: float, z: float, tilt: float = 0.0, yaw: float = 0.0) -> GraspSet:
    """One such grasp."""
    return top_grasps(np.array([x, y, z]), tilt, yaw)[0]

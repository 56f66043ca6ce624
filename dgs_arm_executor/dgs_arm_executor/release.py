"""Where the object is let go: hand poses above the bin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_arm_executor.ik import T_TCP_TOOL0, ArmIK, nearest_turn
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_description.frames import Cell

Array = NDArray[np.float64]

_YAWS = np.deg2rad(np.arange(0, 360, 30))
_LEAST_BELOW, _MOST_BELOW = 0.06, 0.18
"""The fingertips reach 5 cm beyond the TCP; no more than 18 cm of object is believed [m]."""


def release_poses(cell: Cell, carried: CarriedBox | None, clearance: float) -> Array:
    """(N, 4, 4) poses of `hand_tcp`, fingers down over the bin's middle, every 30 degrees about the vertical.

    Args:
        cell: where the bin stands.
        carried: the object; the TCP is as much higher as it hangs down.
        clearance: between the bin's rim and the object [m].
    """
    below = np.clip(0.0 if carried is None else carried.below_tcp, _LEAST_BELOW, _MOST_BELOW)
    poses = np.tile(np.eye(4), (len(_YAWS), 1, 1))
    poses[:, :3, :3] = (
        Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(np.outer(_YAWS, (0, 0, 1)))
    ).as_matrix()
    poses[:, :2, 3] = cell.bin_centre
    poses[:, 2, 3] = cell.table_height + cell.bin_size[2] + clearance + below
    return poses


def release_states(ik: ArmIK, poses: Array, near: Array) -> Array:
    """(K, 6) arm joints of all poses and branches, turned next to `near` (6,), nearest first [rad]."""
    q = nearest_turn(ik.branches(poses @ T_TCP_TOOL0, wrist_3=float(near[5])), near, ik.lower, ik.upper)
    q = q.reshape(-1, 6)
    q = q[~np.isnan(q).any(1)]
    return q[np.argsort(np.abs(q - near).max(1), kind="stable")]

"""UR3 (CB3) forward kinematics: the reference that the URDF is tested against."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.arm_kinematics import arm_kinematics
from dgs_description.frames import Array


def forward_kinematics(q: ArrayLike) -> Array:
    """Pose of `tool0` in `base_link`.

    Args:
        q: (..., 6) arm joints, order of `joints.ARM_JOINTS` [rad].

    Returns:
        (..., 4, 4) T_base_tool0.
    """
    return joint_frames(arm_kinematics().origins, q)[..., -1, :, :]


def joint_frames(origins: Array, q: ArrayLike) -> Array:
    """Poses in `base_link` of the frames that the joints turn.

    `base_link` is turned by pi about z against the chain's base, as in the maker's description.

    Args:
        origins: (6, 4, 4) chain, as in `ArmKinematics`.
        q: (..., 6) joints [rad].

    Returns:
        (..., 6, 4, 4), the last one is `tool0`.
    """
    angles = np.asarray(q, np.float64)
    turns = np.broadcast_to(np.eye(4), (*angles.shape, 4, 4)).copy()
    turns[..., 0, 0] = turns[..., 1, 1] = np.cos(angles)
    turns[..., 1, 0] = np.sin(angles)
    turns[..., 0, 1] = -turns[..., 1, 0]
    frames = origins @ turns
    frames[..., 0, :, :] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ frames[..., 0, :, :]
    for k in range(1, 6):
        frames[..., k, :, :] = frames[..., k - 1, :, :] @ frames[..., k, :, :]
    return frames

"""Facts of a pick that hand driver, arm executor, simulator and evaluation share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.hand_model import YAW_SPREAD
from dgs_description.joints import HAND_LOWER, HAND_UPPER

OPEN_HAND = np.stack([YAW_SPREAD, *np.zeros((3, 5))], axis=1).reshape(20)
"""(20,) straight fingers, fanned out so that neighbours do not touch and what sticks between them falls out [rad]."""
STAND_OFF = 0.10
"""The straight approach starts so far back along the TCP's z [m] (section V of the paper)."""
LIFT = 0.15
"""Straight up with the object [m]."""
WIDEST = 0.088
"""Widest thing that the hand closes on [m]."""
CLOSING_MARGIN = 0.20
"""How far past its final shape the most moving joint of a finger that meets nothing goes on, feeling for the object
[rad]."""
_USUAL_WAY = np.array([0.0, 1.0, 0.7, 0.7])
"""Of a finger that closes without having been opened."""


def closing_limit(start: ArrayLike, grasp_joints: ArrayLike, active: ArrayLike) -> NDArray[np.float64]:
    """Where an empty hand ends: each active finger goes on the way it came, by the margin, within limits.

    Args:
        start: (..., 20) where it began to close, J_init [rad].
        grasp_joints: (..., 20) J_end [rad].
        active: (..., 5) bool.

    Returns:
        (..., 20) joints [rad].
    """
    joints = np.asarray(grasp_joints, dtype=np.float64)
    fingers = (*joints.shape[:-1], 5, 4)
    came = (joints - np.asarray(start, dtype=np.float64)).reshape(fingers)
    most = np.abs(came).max(axis=-1, keepdims=True)
    way = np.where(most < 0.05, _USUAL_WAY, came / np.maximum(most, 1e-9))
    way = np.where(np.asarray(active, dtype=bool)[..., None], CLOSING_MARGIN * way, 0.0)
    return np.clip(joints + way.reshape(joints.shape), HAND_LOWER, HAND_UPPER)

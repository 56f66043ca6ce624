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
MOTION_SPEED = 0.06
"""Of the TCP on a grasp's motion [m/s]: what is pushed does not slide on."""
LIFT = 0.15
"""Straight up with the object [m]."""
WIDEST = 0.088
"""Widest thing that the hand closes on [m]."""
CLOSING_MARGIN = (0.0, 0.20, 0.14)
"""How far past its final yaw, pitch and middle joint a finger that meets nothing goes on, feeling for the object
[rad]."""


def closing_limit(grasp_joints: ArrayLike, active: ArrayLike) -> NDArray[np.float64]:
    """(20,) where an empty hand ends: the final joints plus the margin on the active fingers, within limits [rad].

    Args:
        grasp_joints: (20,) J_end [rad].
        active: (5,) bool.
    """
    yaw, pitch, middle = CLOSING_MARGIN
    joints = np.array(grasp_joints, dtype=np.float64).reshape(5, 4)
    joints[np.asarray(active, dtype=bool)] += (yaw, pitch, middle, middle)
    return np.clip(joints.reshape(20), HAND_LOWER, HAND_UPPER)

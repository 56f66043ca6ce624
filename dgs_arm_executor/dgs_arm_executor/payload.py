"""What the arm carries at its flange, for the robot's own model of its load: mass and centre of gravity. No ROS."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.ik import T_TOOL0_TCP


def payload(
    hand_mass: float, hand_centre: ArrayLike, object_mass: float = 0.0
) -> tuple[float, NDArray[np.float64]]:
    """Mass [kg] and centre of gravity (3,) in `tool0` [m] of the hand and a point mass in its TCP.

    Args:
        hand_mass: of hand and adapter [kg].
        hand_centre: (3,) their centre of gravity in `tool0` [m].
        object_mass: [kg].
    """
    total = hand_mass + object_mass
    moment = hand_mass * np.asarray(hand_centre, float) + object_mass * T_TOOL0_TCP[:3, 3]
    return total, moment / total if total > 0 else np.asarray(hand_centre, float)

"""Facts of a pick that hand driver, arm executor, simulator and evaluation share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

STAND_OFF = 0.10
"""The straight approach starts so far back along the TCP's z [m] (section V of the paper)."""
MOTION_SPEED = 0.15
"""Of the TCP on a grasp's motion [m/s]: what is pushed does not slide on."""
LIFT = 0.15
"""Straight up with the object [m]."""
RETREAT = 0.05
"""So far level back the hand goes from what it has pushed, before it rises [m].

Fingers yield: they lie against the thing like wound springs, and fling it where they come loose all at once.
"""


def way_back(push: GraspSet) -> NDArray[np.float64]:
    """(3,) straight way of the hand from where one push has ended, before it rises: no farther than it came [m].

    None from where a drag has ended: the hand stands around the thing.
    """
    share = 0.0 if push.drags else min(RETREAT / float(np.linalg.norm(push.motion)), 1.0)
    return np.asarray(-share * push.motion)


def closing_limit(grasp_joints: ArrayLike, active: ArrayLike) -> NDArray[np.float64]:
    """(J,) where an empty hand ends: the final joints plus the margin on the active fingers, within limits [rad].

    Args:
        grasp_joints: (J,) J_end [rad].
        active: (F,) bool.
    """
    joints = HAND.split(np.array(grasp_joints, dtype=np.float64))
    joints[np.asarray(active, dtype=bool)] += HAND.beyond[np.asarray(active, dtype=bool)]
    return np.clip(joints.reshape(HAND.joint_count), HAND.lower, HAND.upper)

"""The one answer to "how do things stand": arm, hand, what the hand holds, and what stands around."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.robot_geometry import hand_inertia
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet


@dataclass(frozen=True)
class Load:
    """What the hand holds.

    Attributes:
        grasp: one grasp, with which it was gripped.
        box: around it; None where no point of it was seen.
    """

    grasp: GraspSet
    box: CarriedBox | None = None


@dataclass(frozen=True)
class ArmSituation:
    """Arm, hand and surroundings at one moment; planning starts from it.

    Attributes:
        arm_joints: (6,) [rad].
        hand_joints: (J,) [rad].
        hand_torques: (J,) positive in closing direction [Nm]; None = the hand driver does not tell them.
        cloud: obstacles as last seen.
        load: what the hand holds; None = nothing.
    """

    arm_joints: Array
    hand_joints: Array
    hand_torques: Array | None = None
    cloud: ObstacleCloud = ObstacleCloud()
    load: Load | None = None


def payload(hand_mass: float, hand_centre: ArrayLike, object_mass: float = 0.0) -> tuple[float, Array]:
    """Mass [kg] and centre of gravity (3,) in `tool0` [m] of the hand and an object at its TCP.

    Args:
        hand_mass, hand_centre: of hand and adapter, likewise; a mass of 0 = both as the hand's model has them.
    """
    if not hand_mass:
        hand_mass, hand_centre = hand_inertia()
    total = hand_mass + object_mass
    moment = hand_mass * np.asarray(hand_centre, float) + object_mass * T_TOOL0_TCP[:3, 3]
    return total, moment / total

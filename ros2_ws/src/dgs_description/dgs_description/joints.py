"""Joint names, limits and couplings of the UR3 and the DexHand Pro: the one place where they stand."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import JointNameError

FINGERS = ("thumb", "index", "middle", "ring", "little")
"""Finger order everywhere in the suite."""

HAND_JOINTS = tuple(f"{finger}_joint{k}" for finger in FINGERS for k in (1, 2, 3, 4))
"""The 20 hand joints: yaw, pitch, middle, distal of every finger."""

HAND_ACTIVE_JOINTS = tuple(name for name in HAND_JOINTS if not name.endswith("joint4"))
"""The 15 driven joints; joint4 follows joint3 one to one (steel coupling)."""

ARM_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

# Hand, per finger: yaw, pitch, middle, distal. Limits [rad], effort [Nm]; see docs/hand.md for the sources.
FINGER_LOWER = (-0.261799, 0.0, 0.0, 0.0)
FINGER_UPPER = (0.261799, 1.483530, 1.134464, 1.134464)
FINGER_EFFORT = (1.15, 1.15, 0.60, 0.60)
HAND_LOWER = np.tile(FINGER_LOWER, 5)
HAND_UPPER = np.tile(FINGER_UPPER, 5)
HAND_EFFORT = np.tile(FINGER_EFFORT, 5)
HAND_SPEED = 2.09
"""Software speed limit of every hand joint [rad/s]; the hard limit is 3.14."""

# Arm. Positions [rad]: +-2 pi by the maker, the elbow +-pi for planning. Velocities [rad/s] by the maker.
ARM_LOWER = np.array([-2 * np.pi, -2 * np.pi, -np.pi, -2 * np.pi, -2 * np.pi, -2 * np.pi])
ARM_UPPER = -ARM_LOWER
ARM_VELOCITY = np.array([np.pi, np.pi, np.pi, 2 * np.pi, 2 * np.pi, 2 * np.pi])
ARM_EFFORT = np.array([56.0, 56.0, 28.0, 12.0, 12.0, 12.0])
ARM_ACCELERATION = np.full(6, 5.0)
"""[rad/s^2]; the maker limits torques only, this is what its MoveIt configuration takes."""
ARM_JERK = np.full(6, 50.0)
"""[rad/s^3]: full acceleration after 0.1 s."""
TOOL_SPEED = 1.0
"""Of the arm's tool, by the maker's data sheet [m/s]."""


class JointPath(NamedTuple):
    """A timed path of N joints through K points: (K,) increasing [s], (K, N) [rad], [rad/s], [rad/s^2]."""

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64] | None = None
    accelerations: NDArray[np.float64] | None = None


def expand_active(active: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fill in the coupled distal joints.

    Args:
        active: (..., 15) angles of `HAND_ACTIVE_JOINTS` [rad].

    Returns:
        (..., 20) angles of `HAND_JOINTS` [rad].
    """
    by_finger = np.asarray(active, dtype=np.float64).reshape(*np.shape(active)[:-1], 5, 3)
    return np.concatenate([by_finger, by_finger[..., 2:3]], axis=-1).reshape(*np.shape(active)[:-1], 20)


def reduce_to_active(joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop the coupled distal joints: (..., 20) -> (..., 15) [rad]."""
    by_finger = np.asarray(joints, dtype=np.float64).reshape(*np.shape(joints)[:-1], 5, 4)
    return by_finger[..., :3].reshape(*np.shape(joints)[:-1], 15)


def reorder(names: Sequence[str], values: Sequence[float], wanted: Sequence[str]) -> NDArray[np.float64]:
    """Values of `wanted` joints, looked up by name.

    Args:
        names: joint names as they came, any order, extra names allowed.
        values: one value per name.
        wanted: names to return, in order.

    Returns:
        (len(wanted),) array.

    Raises:
        JointNameError: a wanted name is missing, a name comes twice, or the lengths differ.
    """
    if len(names) != len(values):
        raise JointNameError(f"{len(names)} joint names came with {len(values)} values")
    table: Mapping[str, float] = dict(zip(names, values, strict=True))
    if len(table) != len(names):
        doubled = sorted(name for name, count in Counter(names).items() if count > 1)
        raise JointNameError(f"joints named more than once: {', '.join(doubled)}")
    missing = [name for name in wanted if name not in table]
    if missing:
        raise JointNameError(f"missing joints: {', '.join(missing)}; got {', '.join(names)}")
    return np.array([table[name] for name in wanted], dtype=np.float64)

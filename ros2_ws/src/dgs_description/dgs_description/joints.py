"""Joint names and limits of the UR3, timed joint paths, values looked up by name; the hand's are in `hand.py`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import JointNameError

ARM_JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)

# Positions [rad]: +-2 pi by the maker, the elbow +-pi for planning. Velocities [rad/s] by the maker.
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


def reorder(names: Sequence[str], values: Sequence[float], wanted: Sequence[str]) -> NDArray[np.float64]:
    """Values of `wanted` joints, looked up by name.

    Args:
        names: joint names as they came, any order, extra names allowed.

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

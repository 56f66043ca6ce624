"""Checks a wanted hand move: names, limits, coupling, speed. Refuses with a code and the value that is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode, JointNameError
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.joints import reorder
from dgs_description.words import plural

MODES: dict[int, Literal["position", "grasp"]] = {0: "position", 1: "grasp"}
"""Numbers of MoveHand.action."""
DEFAULT_SPEED = 1.0
"""Of goals that say 0: half of the limit [rad/s]."""
MIN_SPEED = 0.02
"""Slower is taken for a wrong unit: the widest joint would take more than a minute [rad/s]."""
COUPLING_TOLERANCE = 0.01
"""Between a joint and the one that it follows; the error of a measured posture that is sent back [rad]."""
LIMIT_TOLERANCE = 1e-3
"""Rounding that is forgiven and clipped away [rad]."""


@dataclass(frozen=True)
class MoveGoal:
    """A goal that may be sent to the hand."""

    target: Array
    """(J,) within the limits, coupled joints together [rad]"""
    speed: float
    """[rad/s]"""
    mode: Literal["position", "grasp"]
    active: NDArray[np.bool_] | None = None
    """(F,) who closes in a grasp; None = the fingers that flex on the way"""


def parse_goal(
    names: Sequence[str],
    positions: Sequence[float],
    speed: float,
    mode: int,
    active: Sequence[bool] = (),
    default_speed: float = DEFAULT_SPEED,
    max_speed: float = HAND.speed,
) -> MoveGoal:
    """Check a goal as it came; arguments as in MoveHand.action, speeds in [rad/s].

    Raises:
        DgsError: HAND_MODE, HAND_JOINT_NAMES, HAND_NOT_FINITE, HAND_LIMIT, HAND_COUPLING or HAND_SPEED.
    """
    if mode not in MODES:
        known = ", ".join(f"{number} ({name})" for number, name in MODES.items())
        raise DgsError(ErrorCode.HAND_MODE, f"unknown mode {mode}; there are {known}")
    if len(active) not in (0, len(HAND.fingers)):
        wrong = f"active_fingers has {plural(len(active), 'flag')}"
        one_each = f"give one for each of {', '.join(HAND.fingers)}, or none"
        raise DgsError(ErrorCode.HAND_JOINT_NAMES, f"{wrong}; {one_each}")
    target = _joints(names, positions)
    _check_finite(target, speed)
    _check_limits(target)
    _check_coupling(target)
    target = HAND.expand(HAND.reduce(target))
    speed = speed or min(default_speed, max_speed)
    if not MIN_SPEED <= speed <= max_speed:
        limits = f"{MIN_SPEED:g} to {max_speed:g} rad/s; 0 = default"
        raise DgsError(ErrorCode.HAND_SPEED, f"speed {speed:g} rad/s lies outside {limits}")
    stated = np.array(active, dtype=bool) if len(active) else None
    return MoveGoal(np.clip(target, HAND.lower, HAND.upper), float(speed), MODES[mode], stated)


def _joints(names: Sequence[str], positions: Sequence[float]) -> Array:
    unknown = sorted(set(names) - set(HAND.joints))
    if unknown:
        raise DgsError(ErrorCode.HAND_JOINT_NAMES, f"joints not of this hand: {', '.join(unknown)}")
    try:
        if set(names) == set(HAND.driven_joints):
            return HAND.expand(reorder(names, positions, HAND.driven_joints))
        return reorder(names, positions, HAND.joints)
    except JointNameError as error:
        wrong = f"{error.message}; name all {HAND.joint_count}, or the {len(HAND.driven)} that are driven"
        raise DgsError(ErrorCode.HAND_JOINT_NAMES, wrong) from error


def _check_finite(target: Array, speed: float) -> None:
    bad = [name for name, value in zip(HAND.joints, target, strict=True) if not np.isfinite(value)]
    if not np.isfinite(speed):
        bad.append("speed")
    if bad:
        raise DgsError(ErrorCode.HAND_NOT_FINITE, f"not a finite number: {', '.join(bad)}")


def _check_limits(target: Array) -> None:
    for name, value, low, high in zip(HAND.joints, target, HAND.lower, HAND.upper, strict=True):
        if not low - LIMIT_TOLERANCE <= value <= high + LIMIT_TOLERANCE:
            limits = f"{low:.4f} to {high:.4f} rad"
            raise DgsError(ErrorCode.HAND_LIMIT, f"{name} = {value:.4f} rad lies outside its range {limits}")


def _check_coupling(target: Array) -> None:
    coupled = HAND.expand(HAND.reduce(target))
    for k in np.flatnonzero(np.abs(target - coupled) > COUPLING_TOLERANCE):
        leader = f"{HAND.ratio[k]:g} x ".removeprefix("1 x ") + HAND.joints[HAND.source[k]]
        wrong = f"{HAND.joints[k]} = {target[k]:.4f} rad must equal {leader} = {coupled[k]:.4f} rad"
        raise DgsError(ErrorCode.HAND_COUPLING, f"{wrong}: they are coupled")

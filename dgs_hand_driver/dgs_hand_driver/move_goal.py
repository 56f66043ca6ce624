"""Checks a wanted hand move: names, limits, coupling, speed. Refuses with a code and the value that is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import (
    HAND_ACTIVE_JOINTS,
    HAND_JOINTS,
    HAND_LOWER,
    HAND_UPPER,
    expand_active,
    reorder,
)

Array = NDArray[np.float64]

MODES: dict[int, Literal["position", "grasp"]] = {0: "position", 1: "grasp"}
"""Numbers of MoveHand.action."""


@dataclass(frozen=True)
class GoalSettings:
    """Bounds of a goal."""

    default_speed: float = 1.0
    """for goals that say 0 [rad/s]"""
    min_speed: float = 0.02
    """[rad/s]"""
    max_speed: float = 2.09
    """[rad/s]"""
    coupling_tolerance: float = 0.01
    """between joint4 and joint3 [rad]"""
    limit_tolerance: float = 1e-3
    """rounding that is forgiven and clipped away [rad]"""


@dataclass(frozen=True)
class MoveGoal:
    """A goal that may be sent to the hand."""

    target: Array
    """(20,) within the limits, joint4 = joint3 [rad]"""
    speed: float
    """[rad/s]"""
    mode: Literal["position", "grasp"]


def parse_goal(
    names: Sequence[str],
    positions: Sequence[float],
    speed: float,
    mode: int,
    settings: GoalSettings | None = None,
) -> MoveGoal:
    """Check a goal as it came.

    Args:
        names: the 20 joints or the 15 active ones, any order.
        positions: one per name [rad].
        speed: [rad/s], 0 = default.
        mode: 0 position, 1 grasp.
        settings: bounds.

    Raises:
        DgsError: HAND_MODE, HAND_JOINT_NAMES, HAND_NOT_FINITE, HAND_LIMIT, HAND_COUPLING or HAND_SPEED.
    """
    settings = settings or GoalSettings()
    if mode not in MODES:
        known = ", ".join(f"{number} ({name})" for number, name in MODES.items())
        raise DgsError(ErrorCode.HAND_MODE, f"unknown mode {mode}; there are {known}")
    target = _joints(names, positions)
    _check_finite(target, speed)
    _check_limits(target, settings.limit_tolerance)
    _check_coupling(target, settings.coupling_tolerance)
    target.reshape(5, 4)[:, 3] = target.reshape(5, 4)[:, 2]
    return MoveGoal(np.clip(target, HAND_LOWER, HAND_UPPER), _speed(speed, settings), MODES[mode])


def _joints(names: Sequence[str], positions: Sequence[float]) -> Array:
    if len(names) != len(positions):
        raise DgsError(
            ErrorCode.HAND_JOINT_NAMES, f"{len(names)} joint names came with {len(positions)} positions"
        )
    doubled = sorted({name for name in names if list(names).count(name) > 1})
    unknown = sorted(set(names) - set(HAND_JOINTS))
    if doubled or unknown:
        wrong = [f"named twice: {', '.join(doubled)}"] if doubled else []
        wrong += [f"not of this hand: {', '.join(unknown)}"] if unknown else []
        raise DgsError(ErrorCode.HAND_JOINT_NAMES, f"joints {'; '.join(wrong)}")
    if set(names) == set(HAND_ACTIVE_JOINTS):
        return expand_active(reorder(names, positions, HAND_ACTIVE_JOINTS))
    missing = [name for name in HAND_JOINTS if name not in set(names)]
    if missing:
        raise DgsError(
            ErrorCode.HAND_JOINT_NAMES,
            f"missing joints: {', '.join(missing)}; name all 20 or the 15 without the coupled joint4",
        )
    return reorder(names, positions, HAND_JOINTS)


def _check_finite(target: Array, speed: float) -> None:
    bad = [name for name, value in zip(HAND_JOINTS, target, strict=True) if not np.isfinite(value)]
    if not np.isfinite(speed):
        bad.append("speed")
    if bad:
        raise DgsError(ErrorCode.HAND_NOT_FINITE, f"not a finite number: {', '.join(bad)}")


def _check_limits(target: Array, tolerance: float) -> None:
    for name, value, low, high in zip(HAND_JOINTS, target, HAND_LOWER, HAND_UPPER, strict=True):
        if not low - tolerance <= value <= high + tolerance:
            raise DgsError(
                ErrorCode.HAND_LIMIT,
                f"{name} = {value:.4f} rad lies outside its range {low:.4f} to {high:.4f} rad",
            )


def _check_coupling(target: Array, tolerance: float) -> None:
    fingers = target.reshape(5, 4)
    difference = np.abs(fingers[:, 3] - fingers[:, 2])
    worst = int(np.argmax(difference))
    if difference[worst] > tolerance:
        names = HAND_JOINTS[4 * worst + 3], HAND_JOINTS[4 * worst + 2]
        values = fingers[worst, 3], fingers[worst, 2]
        raise DgsError(
            ErrorCode.HAND_COUPLING,
            f"{names[0]} = {values[0]:.4f} rad must equal {names[1]} = {values[1]:.4f} rad: they are coupled",
        )


def _speed(speed: float, settings: GoalSettings) -> float:
    if speed == 0.0:
        return settings.default_speed
    if not settings.min_speed <= speed <= settings.max_speed:
        raise DgsError(
            ErrorCode.HAND_SPEED,
            f"speed {speed:g} rad/s lies outside {settings.min_speed:g} to {settings.max_speed:g} rad/s; 0 = default",
        )
    return float(speed)

"""Joint trajectories as the joint trajectory controller runs them: interpolation, tolerances, result codes. No ROS."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from scipy.interpolate import BPoly

from dgs_description.frames import Array
from dgs_description.joints import ARM_JOINTS, ARM_VELOCITY, JointPath


class FollowCode(IntEnum):
    """Result codes of control_msgs/action/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class TrajectoryRefused(Exception):
    """A trajectory that the controller will not run.

    Attributes:
        code: of control_msgs.
        message: which joint, which limit, by how much.
    """

    def __init__(self, code: FollowCode, message: str):
        super().__init__(message)
        self.code, self.message = code, message


ERASE = -1.0
"""As a tolerance: any deviation is allowed."""
START_TOLERANCE = 0.2
"""A trajectory must begin this close to the measured joints [rad]."""
DECELERATION = 5.0
"""Of the fastest joint of an arm that is stopped [rad/s^2]."""


@dataclass(frozen=True)
class Tolerances:
    """Allowed deviations; infinite = any. Defaults are those of the UR driver's controller configuration.

    Attributes:
        path, path_velocity: (6,) on the way [rad], [rad/s].
        goal, goal_velocity: (6,) at the end [rad], [rad/s].
        goal_time: how much later than planned the goal may be reached [s].
    """

    path: Array = field(default_factory=lambda: np.full(6, 0.2))
    path_velocity: Array = field(default_factory=lambda: np.full(6, np.inf))
    goal: Array = field(default_factory=lambda: np.full(6, 0.1))
    goal_velocity: Array = field(default_factory=lambda: np.full(6, 0.2))
    goal_time: float = np.inf


def chosen(default: float, wanted: float) -> float:
    """A tolerance as control_msgs/JointTolerance means it: 0 keeps the default, -1 allows any deviation.

    Raises:
        TrajectoryRefused: any other negative number, or none at all.
    """
    if wanted == ERASE:
        return np.inf
    if not (np.isfinite(wanted) and wanted >= 0):
        raise TrajectoryRefused(
            FollowCode.INVALID_GOAL, f"a tolerance of {wanted:g}; 0 or more are meant, or -1"
        )
    return wanted or default


def override(defaults: Array, wanted: Iterable[tuple[str, float]]) -> Array:
    """Tolerances (6,) with those of a goal put in.

    Args:
        defaults: (6,).
        wanted: joint name and tolerance, read by `chosen`.

    Raises:
        TrajectoryRefused: unknown joint, or a tolerance that means nothing.
    """
    values = np.array(defaults, dtype=np.float64)
    for name, tolerance in wanted:
        if name not in ARM_JOINTS:
            unknown = f"a tolerance names the unknown joint {name!r}"
            raise TrajectoryRefused(FollowCode.INVALID_JOINTS, unknown)
        joint = ARM_JOINTS.index(name)
        values[joint] = chosen(values[joint], tolerance)
    return values


@dataclass(frozen=True)
class ArmState:
    """Measured joints in the order of `ARM_JOINTS`: (6,) positions [rad], velocities [rad/s], motor torques [Nm]."""

    positions: Array
    velocities: Array
    efforts: Array


@dataclass(frozen=True)
class SetPoint:
    """(6,) positions [rad] and velocities [rad/s], and their time on the trajectory [s]."""

    positions: Array
    velocities: Array
    time: float = 0.0


class Spline:
    """Joint positions over time through way points: quintic with velocities and accelerations, cubic with velocities,
    linear without (the joint trajectory controller's rule)."""

    def __init__(self, path: JointPath) -> None:
        """Interpolate a path of at least two points."""
        given = [values for values in path[1:] if values is not None]
        if path.velocities is None:
            given = given[:1]
        self._position = BPoly.from_derivatives(path.times, list(np.stack(given, axis=1)))
        self._velocity = self._position.derivative()
        self.duration = float(path.times[-1])

    def sample(self, time: float) -> SetPoint:
        """Set point at a time [s]; before the start and after the end the arm stands."""
        inside = min(max(time, 0.0), self.duration)
        position = self._position(inside)
        if inside != time or time == self.duration:
            return SetPoint(position, np.zeros(6))
        return SetPoint(position, self._velocity(inside))


def still_to_come(path: JointPath, elapsed: float) -> JointPath:
    """The points of a path that are not over after `elapsed` seconds, their times from then on; the last one stays."""
    keep = path.times > elapsed
    keep[-1] = True
    velocities, accelerations = (None if values is None else values[keep] for values in path[2:])
    return JointPath(
        np.maximum(path.times[keep] - elapsed, 0.0), path.positions[keep], velocities, accelerations
    )


def spline_from(state: ArmState, path: JointPath) -> Spline:
    """The spline of a goal, from the measured state.

    A first point at time 0 must be where the arm is; a later one is approached from the measured state.

    Raises:
        TrajectoryRefused: the first point is too far away, or too far for the time until it.
    """
    times, positions, velocities, accelerations = path
    distance, allowed = np.abs(positions[0] - state.positions), START_TOLERANCE + ARM_VELOCITY * times[0]
    worst = int(np.argmax(distance - allowed))
    if distance[worst] > allowed[worst]:
        there = f"the measured {ARM_JOINTS[worst]} ({state.positions[worst]:.3f} rad)"
        far = f"the trajectory starts {distance[worst]:.3f} rad away from {there} at {times[0]:.2f} s"
        sentence = f"{far}; {allowed[worst]:.3g} rad are allowed"
        raise TrajectoryRefused(FollowCode.PATH_TOLERANCE_VIOLATED, sentence)
    if times[0] > 0 or len(times) == 1:
        first = times[0] or 1e-3
        times = np.concatenate([[0.0], [first], times[1:]])
        positions = np.concatenate([state.positions[None], positions])
        if velocities is not None:
            velocities = np.concatenate([state.velocities[None], velocities])
        if accelerations is not None:
            accelerations = np.concatenate([np.zeros((1, 6)), accelerations])
    return Spline(JointPath(times, positions, velocities, accelerations))


def braking_spline(now: SetPoint) -> Spline:
    """The way to a stop: every joint slows down together, the fastest by `DECELERATION`."""
    time = max(float(np.abs(now.velocities).max()) / DECELERATION, 0.02)
    stop = now.positions + now.velocities * time / 2
    velocities = np.stack([now.velocities, np.zeros(6)])
    return Spline(JointPath(np.array([0.0, time]), np.stack([now.positions, stop]), velocities))

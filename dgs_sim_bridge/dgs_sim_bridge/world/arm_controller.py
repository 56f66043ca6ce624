"""The trajectory controller of the simulated arm: one goal at a time, tolerances, stop, speed scaling. No ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from dgs_description.frames import Array
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_sim_bridge.world.trajectory import (
    ArmState,
    FollowCode,
    SetPoint,
    Spline,
    Tolerances,
    TrajectoryRefused,
    braking_spline,
    spline_from,
    still_to_come,
)

OnProgress = Callable[[SetPoint, ArmState, float], None]


@dataclass(frozen=True)
class Outcome:
    """How a goal ended: `status` for the action protocol, code and sentence for the result."""

    status: Literal["succeeded", "aborted", "canceled"]
    code: FollowCode
    message: str


@dataclass(frozen=True)
class ArmGoal:
    """A trajectory to follow.

    Attributes:
        path: K points of the 6 joints.
        tolerances: allowed deviations.
        start_time: simulated time of time 0 [s]; None = at once.
        on_end: called once with the outcome, in the simulation's thread.
        on_progress: called with the wanted and the measured state and the seconds since the start while the goal runs.
    """

    path: JointPath
    on_end: Callable[[Outcome], None]
    tolerances: Tolerances = field(default_factory=Tolerances)
    start_time: float | None = None
    on_progress: OnProgress = lambda wanted, measured, passed: None


class ArmController:
    """Turns goals into set points; without a goal the arm holds its position.

    Attributes:
        speed_scaling: share of the planned speed, 0..1; at 0 the time of a trajectory stands still.
    """

    def __init__(self, positions: Array) -> None:
        """Hold the given joints (6,) [rad]."""
        self.speed_scaling = 1.0
        self._goal: ArmGoal | None = None
        self._elapsed, self._passed = 0.0, 0.0
        self._set_point = SetPoint(np.array(positions, float), np.zeros(6))
        self._spline: Spline | None = None

    @property
    def busy(self) -> bool:
        """Whether a goal is running."""
        return self._goal is not None

    def start(self, goal: ArmGoal, state: ArmState, now: float) -> None:
        """Begin a goal in place of the one that runs; one that cannot be run ends at once as aborted.

        Points that are over by now are left out.
        """
        self._end(Outcome("aborted", FollowCode.INVALID_GOAL, "a new goal took this one's place"))
        elapsed = 0.0 if goal.start_time is None else now - goal.start_time
        path = goal.path if elapsed <= 0 else still_to_come(goal.path, elapsed)
        if elapsed < 0:  # until then the arm stands
            self._set_point = SetPoint(self._set_point.positions, np.zeros(6))
            state = replace(state, velocities=np.zeros(6))
        try:
            spline = spline_from(state, path)
        except TrajectoryRefused as refusal:
            self.stop()
            goal.on_end(Outcome("aborted", refusal.code, refusal.message))
            return
        self._goal, self._spline = goal, spline
        self._elapsed, self._passed = min(elapsed, 0.0), 0.0

    def cancel(self, goal: ArmGoal) -> None:
        """Stop a goal on request and hold; nothing happens if it is not the running one."""
        if self._goal is goal:
            held = "canceled on request, the arm holds its position"
            self._end(Outcome("canceled", FollowCode.SUCCESSFUL, held))
            self.stop()

    def abort(self, code: FollowCode, message: str) -> None:
        """End the running goal, if any, as failed, and hold."""
        self._end(Outcome("aborted", code, message))
        self.stop()

    def stop(self) -> None:
        """Brake and hold."""
        self._spline, self._elapsed = braking_spline(self._set_point), 0.0

    def step(self, dt: float, state: ArmState) -> SetPoint:
        """Set point for the next physics step of `dt` seconds, given the measured state."""
        goal, spline = self._goal, self._spline
        if spline is None:
            return self._set_point
        # Braking is not scaled: a stopped robot comes to rest whatever the speed slider says.
        self._elapsed += dt * (self.speed_scaling if goal is not None else 1.0)
        if goal is None:
            self._set_point = spline.sample(self._elapsed)
            if self._elapsed >= spline.duration:
                self._spline = None
        elif self._elapsed >= 0:
            # A goal begins where the arm is, not where the last one's end should have held it.
            asked = self._set_point.positions if self._passed else state.positions
            deviation = np.abs(asked - state.positions)
            self._passed += dt
            # What the trajectory asks for at a time that passes `scaling` times as fast.
            point = spline.sample(self._elapsed)
            slowed = self.speed_scaling * point.velocities
            self._set_point = SetPoint(point.positions, slowed, self._elapsed)
            self._judge(goal, spline, state, deviation)
        return self._set_point

    def _judge(self, goal: ArmGoal, spline: Spline, state: ArmState, deviation: Array) -> None:
        tolerances = goal.tolerances
        if self._elapsed < spline.duration:
            goal.on_progress(self._set_point, state, self._passed)
            too_fast = np.abs(self._set_point.velocities - state.velocities)
            if np.any(deviation > tolerances.path):
                off = _worst("left the path", deviation, tolerances.path)
                self._violated(FollowCode.PATH_TOLERANCE_VIOLATED, off, state)
            elif np.any(too_fast > tolerances.path_velocity):
                off = _worst("left the path's speed", too_fast, tolerances.path_velocity, "rad/s")
                self._violated(FollowCode.PATH_TOLERANCE_VIOLATED, off, state)
            return
        error = np.abs(self._set_point.positions - state.positions)
        standing = np.all(np.abs(state.velocities) <= tolerances.goal_velocity)
        if standing and np.all(error <= tolerances.goal):
            self._end(Outcome("succeeded", FollowCode.SUCCESSFUL, "the goal is reached"))
        elif self._elapsed > spline.duration + tolerances.goal_time:
            missed = f"{tolerances.goal_time:g} s after the end the goal was missed"
            self._violated(FollowCode.GOAL_TOLERANCE_VIOLATED, _worst(missed, error, tolerances.goal), state)

    def _violated(self, code: FollowCode, message: str, state: ArmState) -> None:
        """End the goal as failed and hold where the arm is: the set point may be far away."""
        self._end(Outcome("aborted", code, message))
        self._spline, self._set_point = None, SetPoint(state.positions, np.zeros(6))

    def _end(self, outcome: Outcome) -> None:
        goal, self._goal = self._goal, None
        if goal is not None:
            goal.on_end(outcome)


def _worst(what: str, error: Array, tolerance: Array, unit: str = "rad") -> str:
    joint = int(np.argmax(error - tolerance))
    allowed = f"{tolerance[joint]:g} {unit} are allowed"
    return f"{what}: {ARM_JOINTS[joint]} is off by {error[joint]:.3f} {unit}, {allowed}"

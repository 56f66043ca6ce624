"""What the robot's topics say, and whether motion is allowed: silence, protective stop, latched stop. No ROS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode

Array = NDArray[np.float64]

_LEAST_WALL_SILENCE = 0.1
"""Also this much wall time must pass: a burst of delayed clock messages alone is no silence [s]."""


@dataclass(frozen=True)
class WatchSettings:
    """Limits of silence [s]."""

    silence: float = 0.2
    """In the node's time, which may be simulated and slower than the wall's."""
    wall_silence: float = 5.0
    """In wall time, for simulated time that stands still."""


@dataclass(frozen=True)
class _Sample:
    joints: Array
    time: float
    wall: float


class RobotWatch:
    """Newest joint states, program state, speed scaling, and the stop latch."""

    def __init__(self, now: Callable[[], float], settings: WatchSettings | None = None):
        """`now` gives the node's time [s]."""
        self._now, self._settings = now, settings or WatchSettings()
        self._lock = threading.Lock()
        self._arm: _Sample | None = None
        self._hand: _Sample | None = None
        self._latched: DgsError | None = None
        self.program_running = True
        """False: the robot does not take commands. True also while nobody has said anything."""
        self.speed_scaling = 1.0
        """Share of the commanded speed at which the robot runs, 0..1."""

    def arm_state(self, joints: Array) -> None:
        """A measurement of the arm (6,) [rad] came in."""
        with self._lock:
            self._arm = _Sample(joints, self._now(), time.monotonic())

    def hand_state(self, joints: Array) -> None:
        """A measurement of the hand (20,) [rad] came in."""
        with self._lock:
            self._hand = _Sample(joints, self._now(), time.monotonic())

    def latch(self, code: ErrorCode, reason: str) -> None:
        """Forbid motion until `reset`; the first reason stays."""
        with self._lock:
            self._latched = self._latched or DgsError(code, reason)

    def reset(self) -> str:
        """Allow motion again and say what was the matter.

        Raises:
            DgsError: PROTECTIVE_STOP: the robot's program does not run, so motion cannot be allowed.
        """
        if not self.program_running:
            raise DgsError(
                ErrorCode.PROTECTIVE_STOP,
                "the robot's program does not run: clear the stop at the robot and start the program, then reset",
            )
        with self._lock:
            before, self._latched = self._latched, None
        return f"motion is allowed again after: {before.message}" if before else "there was no stop"

    @property
    def latched(self) -> DgsError | None:
        """Why motion is forbidden, or None."""
        with self._lock:
            return self._latched

    def arm_joints(self) -> Array:
        """(6,) newest measurement [rad].

        Raises:
            DgsError: JOINT_STATES_SILENT.
        """
        return self._fresh(self._arm, ErrorCode.JOINT_STATES_SILENT, "/joint_states")

    def hand_joints(self) -> Array:
        """(20,) newest measurement [rad].

        Raises:
            DgsError: HAND_UNAVAILABLE.
        """
        return self._fresh(self._hand, ErrorCode.HAND_UNAVAILABLE, "/dexhand/joint_states", patience=10.0)

    def check_motion(self) -> None:
        """Whether the arm may move.

        Raises:
            DgsError: STOPPED or PROTECTIVE_STOP (latched from then on), JOINT_STATES_SILENT.
        """
        if not self.program_running:
            self.latch(
                ErrorCode.PROTECTIVE_STOP,
                "the robot's program stopped (protective or emergency stop, or ended by hand)",
            )
        latched = self.latched
        if latched is not None:
            raise DgsError(latched.code, f"{latched.message}; call /reset to allow motion")
        self.arm_joints()

    def _fresh(self, sample: _Sample | None, code: ErrorCode, topic: str, patience: float = 1.0) -> Array:
        if sample is None:
            raise DgsError(code, f"nothing has come on {topic} yet")
        age, wall = self._now() - sample.time, time.monotonic() - sample.wall
        limit = self._settings.silence * patience
        if (age > limit and wall > _LEAST_WALL_SILENCE) or wall > self._settings.wall_silence:
            raise DgsError(
                code, f"{topic} has been silent for {max(age, 0.0):.2f} s ({wall:.2f} s on the wall clock)"
            )
        return sample.joints

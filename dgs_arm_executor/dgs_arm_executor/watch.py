"""What the robot's topics say, and whether motion is allowed: silence, protective stop, latched stop. No ROS."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dgs_arm_executor.force_guard import MAX_FORCE, ForceGuard
from dgs_arm_executor.joint_history import JointHistory
from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array

TICK = 0.04
"""Period of `RobotWatch.tick` [s]."""
_AWAKE = 2 * TICK
"""Of a longer pause between two ticks only so much counts: the program itself did not run and heard nobody [s]."""

STANDS, STANDING = 0.1, 0.01
"""Joints that have moved by less than the second [rad] over the first [s of the node's time] are at rest."""
REST_TIMEOUT = 5.0
"""[s], wall time."""
SILENCE = 0.2
"""So long a robot may be silent, in the node's time and in wall time alike: simulated time may lag behind, and catches
up in bursts [s]."""
WALL_SILENCE = 5.0
"""In wall time, for simulated time that stands still [s]."""

SAFETY_MODES = (
    "unknown", "normal", "reduced", "protective stop", "recovery", "safeguard stop", "system emergency stop",
    "robot emergency stop", "violation", "fault",
)  # fmt: skip
"""By the numbers of the UR driver's topic `safety_mode`."""
_MOVING_MODES = (1, 2)


@dataclass
class _Source:
    """Newest measurement of one topic, and for how long nothing newer has come."""

    joints: Array | None = None
    torques: Array | None = None
    age: float = 0.0
    wall_age: float = 0.0


class RobotWatch:
    """Newest joint states, program state, safety mode, speed scaling, and the stop latch.

    Attributes:
        now: gives the node's time [s].
        wait: lets time pass [s]; a simulation in the same thread goes on meanwhile.
        speed_scaling: share of the commanded speed at which the robot runs, 0..1.
        force: what the hand presses on.
        stop: the newest stop that was latched, also after its `reset`; None = none yet.

    Silence is time in which this program was awake and heard nothing: `tick` adds it up in small steps. The clocks'
    difference alone would take a pause of the program itself (a busy machine, a long computation) for a silent robot.
    """

    def __init__(
        self,
        now: Callable[[], float],
        silence: float = SILENCE,
        tell: Callable[[bool], None] = lambda _: None,
        max_force: float = MAX_FORCE,
        wait: Callable[[float], None] = time.sleep,
    ):
        """Nothing is known yet, and nothing stopped.

        Args:
            silence: so long the robot may say nothing, ten times so long the hand [s].
            tell: told whether a stop is latched, now and at every change.
            max_force: see `ForceGuard` [N].
        """
        self.now, self.wait, self._silence, self._tell = now, wait, silence, tell
        self._lock = threading.Lock()
        self._arm, self._hand = _Source(), _Source()
        self._arm_history, self._hand_history = JointHistory(), JointHistory()
        self._ticked, self._ticked_wall = now(), time.monotonic()
        self._latched: DgsError | None = None
        self.stop: DgsError | None = None
        self._program_running, self._safety_mode = True, 1
        self.speed_scaling = 1.0
        self.force = ForceGuard(max_force)
        tell(False)

    def arm_state(self, joints: Array, stamp: float = 0.0) -> None:
        """A measurement of the arm (6,) [rad], taken at a time [s], came in."""
        with self._lock:
            self._arm = _Source(joints)
            self._arm_history.add(stamp, joints)

    def hand_state(self, joints: Array, torques: Array | None = None, stamp: float = 0.0) -> None:
        """A measurement of the hand (J,) [rad] came in, and (J,) torques [Nm] where the driver tells them."""
        with self._lock:
            self._hand = _Source(joints, torques)
            self._hand_history.add(stamp, joints)

    def tick(self) -> None:
        """Let the measurements age; call it every `TICK` seconds from where the measurements are taken in."""
        now, wall = self.now(), time.monotonic()
        with self._lock:
            passed, lasted = max(now - self._ticked, 0.0), max(wall - self._ticked_wall, 1e-9)
            self._ticked, self._ticked_wall = now, wall
            share = min(1.0, _AWAKE / lasted)
            for source in (self._arm, self._hand):
                source.age += share * passed
                source.wall_age += share * lasted

    def program_state(self, running: bool) -> None:
        """Whether the robot takes commands; that it ends is latched. Nobody having said anything counts as running."""
        self._program_running = running
        self._latch_halt()

    def safety_state(self, mode: int) -> None:
        """Safety mode as the UR driver numbers it; a stop is latched. Nobody having said anything counts as normal."""
        self._safety_mode = mode
        self._latch_halt()

    def speed_state(self, percent: float) -> None:
        """Speed scaling as the UR driver publishes it: percent, whatever its documentation says."""
        self.speed_scaling = float(np.clip(percent / 100.0, 0.0, 1.0)) if np.isfinite(percent) else 0.0

    def latch(self, code: ErrorCode, reason: str) -> None:
        """Forbid motion until `reset`; the first reason stays."""
        with self._lock:
            if self._latched is None:
                self._latched = self.stop = DgsError(code, reason)
                self._tell(True)

    def reset(self) -> str:
        """Allow motion again and say what was the matter. Raises DgsError PROTECTIVE_STOP while it lasts."""
        halted = self._halted()
        if halted is not None:
            cure = "clear it at the robot, start the program, then reset"
            raise DgsError(ErrorCode.PROTECTIVE_STOP, f"{halted}: {cure}")
        with self._lock:
            before, self._latched = self._latched, None
            self._tell(False)
        return f"motion is allowed again after: {before.message}" if before else "there was no stop"

    @property
    def latched(self) -> DgsError | None:
        """Why motion is forbidden, or None."""
        with self._lock:
            return self._latched

    def situation(self) -> ArmSituation:
        """Newest measurements of arm and hand. Raises DgsError JOINT_STATES_SILENT, HAND_UNAVAILABLE."""
        self.arm_joints()
        return self._hand_situation()

    def situation_at(self, stamp: float) -> ArmSituation:
        """Arm and hand at a time [s] of the last seconds, now where it is none. Raises as `situation`."""
        now = self.situation()
        with self._lock:
            arm, hand = self._arm_history.at(stamp), self._hand_history.at(stamp)
        return ArmSituation(now.arm_joints if arm is None else arm, now.hand_joints if hand is None else hand)

    def arm_joints(self) -> Array:
        """(6,) newest measurement [rad]. Raises DgsError JOINT_STATES_SILENT if nothing is heard of the arm."""
        source = self._arm
        self._check_heard(source, ErrorCode.JOINT_STATES_SILENT, "/joint_states", self._silence)
        assert source.joints is not None
        return source.joints

    def arm_stands(self) -> bool:
        """Whether the arm was heard for `STANDS` and has not moved over it: not of before a silence, nor braking."""
        with self._lock:
            return self._arm_history.moved(STANDS) < STANDING

    def check_hand(self) -> None:
        """Raise DgsError HAND_UNAVAILABLE if nothing is heard of the hand."""
        self._check_heard(self._hand, ErrorCode.HAND_UNAVAILABLE, "/dexhand/joint_states", 10 * self._silence)

    def hand_at_rest(self) -> ArmSituation:
        """When no finger has moved for `STANDS`; for a hand that was just stopped on its way, also of a silent arm.

        Raises DgsError HAND_UNAVAILABLE if the hand falls silent, or still moves after `REST_TIMEOUT`.
        """
        end = time.monotonic() + REST_TIMEOUT
        before, since = self._hand_situation(), self.now()
        while time.monotonic() < end:
            self.wait(0.005)
            now = self._hand_situation()
            if abs(self.now() - since) < STANDS or now.hand_joints is before.hand_joints:
                continue
            if float(np.abs(now.hand_joints - before.hand_joints).max()) < STANDING:
                return now
            before, since = now, self.now()
        raise DgsError(ErrorCode.HAND_UNAVAILABLE, f"the hand has not come to rest within {REST_TIMEOUT:g} s")

    def check_motion(self) -> None:
        """Raise DgsError if the arm may not move: STOPPED, PROTECTIVE_STOP (then latched), JOINT_STATES_SILENT."""
        self._latch_halt()
        latched = self.latched
        if latched is not None:
            raise DgsError(latched.code, f"{latched.message}; call /reset to allow motion")
        self.arm_joints()

    def _halted(self) -> str | None:
        """Why the robot itself does not move, or None."""
        if self._safety_mode not in _MOVING_MODES:
            known = self._safety_mode if self._safety_mode < len(SAFETY_MODES) else 0
            return f"the robot's safety mode is {self._safety_mode} ({SAFETY_MODES[known]})"
        if not self._program_running:
            return "the robot's program does not run (emergency stop, or ended by hand)"
        return None

    def _latch_halt(self) -> None:
        halted = self._halted()
        if halted is not None:
            self.latch(ErrorCode.PROTECTIVE_STOP, halted)

    def _hand_situation(self) -> ArmSituation:
        """The arm may be silent. Raises DgsError HAND_UNAVAILABLE."""
        self.check_hand()
        with self._lock:
            arm, hand = self._arm.joints, self._hand
        assert hand.joints is not None
        return ArmSituation(np.full(6, np.nan) if arm is None else arm, hand.joints, hand.torques)

    def _check_heard(self, source: _Source, code: ErrorCode, topic: str, limit: float) -> None:
        if source.joints is None:
            raise DgsError(code, f"nothing has come on {topic} yet")
        if min(source.age, source.wall_age) > limit or source.wall_age > WALL_SILENCE:
            silence = f"{source.age:.2f} s ({source.wall_age:.2f} s on the wall clock)"
            raise DgsError(code, f"{topic} has been silent for {silence}")

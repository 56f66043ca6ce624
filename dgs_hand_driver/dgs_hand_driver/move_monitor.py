"""Decides from the hand's states when a move has ended, and how: arrived, blocked, timed out, holding something.

All durations are in the hand's own clock, so a simulation that runs slower than real time is not a stalled hand.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.errors import ErrorCode
from dgs_description.joints import FINGERS, HAND_ACTIVE_JOINTS, reduce_to_active
from dgs_hand_driver.hand_state import HandState

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class MoveSettings:
    """When a move counts as arrived, blocked, still or too late. Triples are yaw, pitch, middle (with distal)."""

    position_tolerance: float = 0.02
    """every joint this close: arrived [rad]"""
    settled_tolerance: float = 0.08
    """still and this close: arrived too, the rest is load and play [rad]"""
    blocked_torque: tuple[float, float, float] = (0.6, 0.6, 0.6)
    """a drive that pushes harder towards a target farther than `settled_tolerance` has met something [Nm]"""
    blocked_time: float = 0.15
    """for so long [s]"""
    contact_torque: tuple[float, float, float] = (0.3, 0.15, 0.15)
    """a closing finger that pushes harder holds something [Nm]"""
    contact_lag: float = 0.05
    """a closing finger that stopped so far before its closing target holds something [rad]"""
    still_speed: float = 0.03
    """slower is standing still [rad/s]"""
    still_time: float = 0.3
    """for so long [s]"""
    timeout_factor: float = 3.0
    """a move may take the time that its way takes at its speed times this ..."""
    timeout_extra: float = 3.0
    """... plus this [s]"""


@dataclass(frozen=True)
class MoveOutcome:
    """How a move ended."""

    code: ErrorCode
    message: str
    state: HandState
    fingers_in_contact: tuple[str, ...] = ()


class _Progress:
    """What both kinds of move need: time since the start, distance to go, which joints stand still."""

    def __init__(self, start: HandState, target: ArrayLike, speed: float, settings: MoveSettings) -> None:
        self.settings = settings
        self.start = start
        self.target = reduce_to_active(np.asarray(target, dtype=np.float64))
        self.distance = float(np.abs(self.target - reduce_to_active(start.positions)).max())
        self.travel_time = self.distance / speed
        self.timeout = settings.timeout_factor * self.travel_time + settings.timeout_extra
        # A slow move must not look like standing still.
        self.still_motion = min(settings.still_speed, 0.2 * speed) * settings.still_time
        self._window: deque[tuple[float, Array]] = deque()

    def update(self, state: HandState) -> None:
        self.elapsed = state.clock - self.start.clock
        self.active = reduce_to_active(state.positions)
        self.to_go = self.target - self.active
        self._window.append((state.clock, self.active))
        while len(self._window) > 1 and self._window[1][0] <= state.clock - self.settings.still_time:
            self._window.popleft()

    def still(self) -> Flags:
        """(15,) joints that have hardly moved in the last `still_time`."""
        if self._window[-1][0] - self._window[0][0] < self.settings.still_time:
            return np.zeros(15, dtype=bool)
        positions = np.array([positions for _, positions in self._window])
        motion = positions.max(axis=0) - positions.min(axis=0)
        return np.asarray(motion < self.still_motion)

    def fraction(self) -> float:
        """How much of the longest way is done, 0..1."""
        if self.distance < 1e-9:
            return 1.0
        return float(np.clip(1.0 - np.abs(self.to_go).max() / self.distance, 0.0, 1.0))


class PositionMove:
    """Watches a move to positions: contact on the way is a fault, contact that is left behind is not."""

    def __init__(
        self, start: HandState, target: ArrayLike, speed: float, settings: MoveSettings | None = None
    ) -> None:
        """Begin.

        Args:
            start: newest state, the hand has taken the command.
            target: (20,) [rad].
            speed: limit of every joint [rad/s].
            settings: tolerances.
        """
        self._settings = settings or MoveSettings()
        self._progress = _Progress(start, target, speed, self._settings)
        self._limit = np.tile(self._settings.blocked_torque, 5)
        self._pushing_since = np.full(15, np.inf)

    @property
    def progress(self) -> float:
        """0..1"""
        return self._progress.fraction()

    def update(self, state: HandState) -> MoveOutcome | None:
        """Take a state; an outcome ends the move."""
        progress = self._progress
        progress.update(state)
        distance = np.abs(progress.to_go)
        if distance.max() < self._settings.position_tolerance:
            return MoveOutcome(ErrorCode.SUCCESS, "the hand has arrived", state)
        far = distance > self._settings.settled_tolerance
        # Only a drive that pushes towards its target counts: an opening finger feels what it leaves behind.
        pushing = far & (reduce_to_active(state.torques) * np.sign(progress.to_go) > self._limit)
        self._pushing_since = np.where(pushing, np.minimum(self._pushing_since, state.clock), np.inf)
        pushed = state.clock - self._pushing_since > self._settings.blocked_time
        still = progress.still()
        stuck = pushed | (far & still)
        if stuck.any():
            return self._blocked(state, stuck)
        if still.all():
            rest = float(distance.max())
            return MoveOutcome(ErrorCode.SUCCESS, f"the hand has arrived, {rest:.3f} rad short", state)
        if progress.elapsed > progress.timeout:
            name = HAND_ACTIVE_JOINTS[int(distance.argmax())]
            text = f"not there after {progress.elapsed:.1f} s: {name} has {distance.max():.3f} rad to go"
            return MoveOutcome(ErrorCode.HAND_TIMEOUT, text, state)
        return None

    def _blocked(self, state: HandState, stuck: Flags) -> MoveOutcome:
        torques = reduce_to_active(state.torques)
        parts = [
            f"{HAND_ACTIVE_JOINTS[k]} ({abs(self._progress.to_go[k]):.3f} rad to go, {torques[k]:.2f} Nm)"
            for k in np.flatnonzero(stuck)
        ]
        fingers = tuple(FINGERS[k] for k in np.flatnonzero(stuck.reshape(5, 3).any(axis=1)))
        return MoveOutcome(
            ErrorCode.HAND_BLOCKED, f"met something on the way: {', '.join(parts)}", state, fingers
        )


class GraspMove:
    """Watches a closing under admittance control: it ends when the fingers stand still, in contact or not."""

    def __init__(
        self,
        start: HandState,
        target: ArrayLike,
        speed: float,
        active: ArrayLike,
        settings: MoveSettings | None = None,
    ) -> None:
        """Begin.

        Args:
            start: newest state, the hand has taken the command.
            target: (20,) closing target, margin included [rad].
            speed: limit of every joint [rad/s].
            active: (5,) fingers that take part.
            settings: tolerances.
        """
        self._settings = settings or MoveSettings()
        self._progress = _Progress(start, target, speed, self._settings)
        self._active = np.asarray(active, dtype=bool)
        self._contact_torque = np.asarray(self._settings.contact_torque)

    @property
    def progress(self) -> float:
        """0..1; a finger that holds something does not reach its target, so time counts as well."""
        progress = self._progress
        return max(progress.fraction(), min(1.0, progress.elapsed / max(progress.travel_time, 1e-3)))

    def update(self, state: HandState) -> MoveOutcome | None:
        """Take a state; an outcome ends the move."""
        progress = self._progress
        progress.update(state)
        # The set point walks on while a finger already stands: the full closing force is there only at its end.
        walked = progress.elapsed > progress.travel_time + self._settings.still_time
        late = progress.elapsed > progress.timeout
        if not late and not (walked and progress.still().all()):
            return None
        fingers = self.contacts(state)
        text = f"in contact: {', '.join(fingers)}" if fingers else "no finger is in contact"
        if not self._active.any():
            text = "no finger had to flex, so none closes"
        if late:
            text += f"; still moving after {progress.elapsed:.1f} s"
        return MoveOutcome(ErrorCode.SUCCESS, text, state, fingers)

    def contacts(self, state: HandState) -> tuple[str, ...]:
        """Closing fingers that push, or that stopped short of their closing target."""
        torque = reduce_to_active(state.torques).reshape(5, 3)
        lag = self._progress.to_go.reshape(5, 3)
        touches = (torque > self._contact_torque) | (lag > self._settings.contact_lag)
        found = touches[:, 1:].any(axis=1) & self._active
        return tuple(FINGERS[k] for k in np.flatnonzero(found))

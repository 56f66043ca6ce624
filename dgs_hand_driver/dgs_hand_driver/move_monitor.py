"""Decides from the hand's states when a move has ended, and how: arrived, blocked, timed out, holding something.

All durations are in the hand's own clock, so a simulation that runs slower than real time is not a stalled hand.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.errors import ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_hand_driver.fingertips import CONTACT_FORCE, in_contact
from dgs_hand_driver.hand_state import HandState

Flags = NDArray[np.bool_]
Triple = tuple[float, float, float]
"""Of yaw, pitch, middle (with distal)."""
_KIND = np.minimum(HAND.driven % JOINTS_PER_FINGER, 2)
"""(D,) which of a `Triple` is a driven joint's."""

# Tuned in the simulator, with torques and play as of docs/hand.md.
POSITION_TOLERANCE = 0.02
"""Every joint this close: arrived [rad]."""
SETTLED_TOLERANCE = 0.08
"""Still and this close: arrived too, the rest is load and play [rad]."""
BLOCKED_TORQUE: Triple = (0.6, 0.6, 0.6)
"""A drive that pushes harder towards a target farther than `SETTLED_TOLERANCE` has met something [Nm]."""
BLOCKED_TIME = 0.15
"""For so long [s]."""
CONTACT_TORQUE: Triple = (0.3, 0.15, 0.15)
"""A closing finger that pushes harder holds something; the yaw says nothing [Nm]."""
CONTACT_LAG = 0.05
"""A closing finger that stopped so far before its closing target holds something [rad]."""
STILL_SPEED = 0.03
"""Slower is standing still [rad/s]."""
STILL_TIME = 0.3
"""For so long [s]."""
CREEP_SPEED = 0.2
"""Slower is standing still for fingers that hold something: what gives way a little in the hand is not worth waiting
for, and longer squeezing works it out of the hand [rad/s]."""
TIMEOUT_FACTOR, TIMEOUT_EXTRA = 3.0, 3.0
"""A move may take the time that its way takes at its speed times the first, plus the second [s]."""


@dataclass(frozen=True)
class MoveOutcome:
    """How a move ended."""

    code: ErrorCode
    message: str
    state: HandState
    fingers_in_contact: tuple[str, ...] = ()


class Move(ABC):
    """A move in work: time since its start, distance to go, which joints stand still."""

    still_speed = STILL_SPEED

    def __init__(self, start: HandState, target: ArrayLike, speed: float) -> None:
        """From the state that acknowledges the command to (J,) joints, margin included [rad], at `speed` [rad/s]."""
        self._target = HAND.reduce(np.asarray(target, dtype=np.float64))
        self._start = start.clock
        self._distance = float(np.abs(self._target - HAND.reduce(start.positions)).max())
        self._travel_time = self._distance / speed
        self._timeout = TIMEOUT_FACTOR * self._travel_time + TIMEOUT_EXTRA
        # A slow move must not look like standing still.
        self._still_motion = min(self.still_speed, 0.2 * speed) * STILL_TIME
        self._window: deque[tuple[float, Array]] = deque()

    def update(self, state: HandState) -> MoveOutcome | None:
        """Take a state; an outcome ends the move."""
        active = HAND.reduce(state.positions)
        self._elapsed, self._to_go = state.clock - self._start, self._target - active
        self._window.append((state.clock, active))
        while len(self._window) > 1 and self._window[1][0] <= state.clock - STILL_TIME:
            self._window.popleft()
        return self._judge(state)

    @property
    def progress(self) -> float:
        """How much of the longest way is done, 0..1."""
        if self._distance < 1e-9:
            return 1.0
        return float(np.clip(1.0 - np.abs(self._to_go).max() / self._distance, 0.0, 1.0))

    @abstractmethod
    def _judge(self, state: HandState) -> MoveOutcome | None:
        """Whether the newest state ends the move."""

    def _still(self) -> Flags:
        """(D,) joints that have hardly moved in the last `STILL_TIME`."""
        if self._window[-1][0] - self._window[0][0] < STILL_TIME:
            return np.zeros(len(HAND.driven), dtype=bool)
        positions = np.array([positions for _, positions in self._window])
        return np.asarray(np.ptp(positions, axis=0) < self._still_motion)


class PositionMove(Move):
    """Watches a move to positions: contact on the way is a fault, contact that is left behind is not."""

    def __init__(
        self, start: HandState, target: ArrayLike, speed: float, blocked_torque: Triple = BLOCKED_TORQUE
    ) -> None:
        super().__init__(start, target, speed)
        self._limit = np.asarray(blocked_torque)[_KIND]
        self._pushing_since = np.full(len(HAND.driven), np.inf)

    def _judge(self, state: HandState) -> MoveOutcome | None:
        distance = np.abs(self._to_go)
        if distance.max() < POSITION_TOLERANCE:
            return MoveOutcome(ErrorCode.SUCCESS, "the hand has arrived", state)
        far = distance > SETTLED_TOLERANCE
        # Only a drive that pushes towards its target counts: an opening finger feels what it leaves behind.
        pushing = far & (HAND.reduce(state.torques) * np.sign(self._to_go) > self._limit)
        self._pushing_since = np.where(pushing, np.minimum(self._pushing_since, state.clock), np.inf)
        still = self._still()
        stuck = (state.clock - self._pushing_since > BLOCKED_TIME) | (far & still)
        if stuck.any():
            return self._blocked(state, stuck)
        if still.all():
            text = f"the hand has arrived, {distance.max():.3f} rad short"
            return MoveOutcome(ErrorCode.SUCCESS, text, state)
        if self._elapsed > self._timeout:
            name = HAND.driven_joints[int(distance.argmax())]
            text = f"not there after {self._elapsed:.1f} s: {name} has {distance.max():.3f} rad to go"
            return MoveOutcome(ErrorCode.HAND_TIMEOUT, text, state)
        return None

    def _blocked(self, state: HandState, stuck: Flags) -> MoveOutcome:
        torques = HAND.reduce(state.torques)
        parts = [
            f"{HAND.driven_joints[k]} ({abs(self._to_go[k]):.3f} rad to go, {torques[k]:.2f} Nm)"
            for k in np.flatnonzero(stuck)
        ]
        text = f"met something on the way: {', '.join(parts)}"
        return MoveOutcome(ErrorCode.HAND_BLOCKED, text, state, _names(_of_fingers(stuck)))


class GraspMove(Move):
    """Watches a closing under admittance control: it ends when the fingers stand still, in contact or not."""

    still_speed = CREEP_SPEED

    def __init__(
        self,
        start: HandState,
        target: ArrayLike,
        speed: float,
        active: ArrayLike,
        contact_torque: Triple = CONTACT_TORQUE,
        contact_force: float = CONTACT_FORCE,
    ) -> None:
        """As `Move`; `active` (F,) says which fingers take part."""
        super().__init__(start, target, speed)
        self._active = np.asarray(active, dtype=bool)
        self._contact_torque = np.asarray(contact_torque)
        self._contact_force = contact_force

    @property
    def progress(self) -> float:
        """0..1; a finger that holds something does not reach its target, so time counts as well."""
        return max(super().progress, min(1.0, self._elapsed / max(self._travel_time, 1e-3)))

    def _judge(self, state: HandState) -> MoveOutcome | None:
        # The set point walks on while a finger already stands: the full closing force is there only at its end.
        walked = self._elapsed > self._travel_time + STILL_TIME
        late = self._elapsed > self._timeout
        if not late and not (walked and self._still().all()):
            return None
        fingers = self._contacts(state)
        text = f"in contact: {', '.join(fingers)}" if fingers else "no finger is in contact"
        if not self._active.any():
            text = "no finger takes part, so none closes"
        if late:
            text += f"; still moving after {self._elapsed:.1f} s"
        return MoveOutcome(ErrorCode.SUCCESS, text, state, fingers)

    def _contacts(self, state: HandState) -> tuple[str, ...]:
        """Closing fingers that feel something, that push, or that stopped short of their closing target.

        What a hand's fingertips feel does not overrule its joints: fingers also hold with their other links.
        """
        pushing = HAND.reduce(state.torques) > self._contact_torque[_KIND]
        touches = (pushing | (self._to_go > CONTACT_LAG)) & (_KIND > 0)
        fingers = _of_fingers(touches)
        if state.forces is not None:
            fingers |= in_contact(state.forces, self._contact_force)
        return _names(fingers & self._active)


def _of_fingers(joints: Flags) -> Flags:
    """(F,) fingers with any of the (D,) driven joints."""
    return np.asarray(np.bincount(HAND.driven[joints] // JOINTS_PER_FINGER, minlength=HAND.finger_count) > 0)


def _names(fingers: ArrayLike) -> tuple[str, ...]:
    return tuple(HAND.fingers[k] for k in np.flatnonzero(fingers))

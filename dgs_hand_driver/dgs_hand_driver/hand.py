"""A hand at the end of a CAN bus: connection, newest state, moves, stop. ROS-free."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import can
import numpy as np
from numpy.typing import ArrayLike

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from dgs_description.pick import closing_limit
from dgs_hand_driver.admittance import active_fingers
from dgs_hand_driver.bus import BusSettings, open_bus
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand, HandState, Mode
from dgs_hand_driver.move_goal import MoveGoal
from dgs_hand_driver.move_monitor import GraspMove, Move, MoveOutcome, PositionMove
from dgs_hand_driver.protocol import NO_FINGER, protocol_class

logger = logging.getLogger(__name__)

OnProgress = Callable[[HandState, float], None]

RETRY_PERIOD = 0.5
"""Pause before a bus that could not be opened, or was lost, is tried again [s]."""
_POLL = 0.1
"""How long the reader waits for a frame before it looks whether it shall end [s]."""
_RESEND_PERIOD = 0.05
"""Pause before a command that was not acknowledged is sent again [s]."""
_GREET_PERIOD = 1.0
"""A hand that sends frames but no states for so long is greeted again: a board may have started late [s]."""
_FAULT_PATIENCE = 0.5
"""A hand that is told to end a fault has this long [s]."""
_HOLD_SPEED = 1.0
"""A hold moves nothing, but its frame has the field [rad/s]."""


class DexHand:
    """Connects and reads states in a thread of its own; `move` runs in the caller's thread. One mover at a time.

    The hand or the simulator may come later, and come back after a loss: until then every request is HAND_BUS.

    Attributes:
        lost: why the connection is lost, None while it is there.
    """

    _sequence: int | None

    def __init__(
        self,
        bus: BusSettings,
        settings: HandSettings | None = None,
        on_state: Callable[[HandState], None] = lambda _: None,
    ) -> None:
        """Begin to connect; `on_state` is called in the reader's thread with every state.

        Raises:
            DgsError: HAND_PROTOCOL, nobody knows how to speak with this hand; PARAMETER_INVALID, a bad DBC.
        """
        self.settings = settings or HandSettings()
        self._speak = protocol_class()
        self._on_state = on_state
        self._news = threading.Condition()
        self._send_lock = threading.Lock()
        self.lost: str | None = "the CAN bus has not been opened yet"
        self._ended = threading.Event()
        self._reset(None)
        self._reader = threading.Thread(target=self._run, args=(bus,), name="hand reader", daemon=True)
        self._reader.start()

    def close(self) -> None:
        """Stop reading and close the bus; the hand keeps its last command."""
        self._ended.set()
        self._reader.join()

    @property
    def incomplete_cycles(self) -> int:
        """States dropped because a frame was lost or damaged."""
        return self._protocol.incomplete

    @property
    def fault(self) -> DgsError | None:
        """The fault that the hand reports at present."""
        return self._protocol.fault

    def state(self) -> HandState:
        """Newest state. Raises DgsError HAND_BUS: connection lost; HAND_SILENT: no state, or only an old one."""
        self._check_bus()
        state = self._protocol.state
        age = time.monotonic() - (state.received if state else self._opened)
        if state is None or age > self.settings.silence_timeout:
            silent = f"no joint states from the hand for {age:.1f} s although the CAN bus is open"
            absent = self._protocol.absent
            hint = f"nothing is heard from {absent}" if absent else "is the hand powered?"
            raise DgsError(ErrorCode.HAND_SILENT, f"{silent}; {hint}")
        return state

    def move(
        self,
        goal: MoveGoal,
        on_progress: OnProgress = lambda state, progress: None,
        cancelled: Callable[[], str] = lambda: "",
    ) -> MoveOutcome:
        """Move the hand and wait for the end.

        A move to positions that meets something, runs late or is cancelled leaves the hand holding where it is.
        Fingers of a grasp that meet nothing go on up to `closing_limit`; its success leaves the hand squeezing.

        Args:
            on_progress: called with every state and the progress 0..1.
            cancelled: why the move shall end, "" = it goes on; asked at every state, and every 0.1 s without one.

        Raises:
            DgsError: HAND_SILENT, HAND_BUS, or what the hand reports, e.g. HAND_INTERNAL.
        """
        given = self.settings
        start = self._first_state()
        self._end_fault()
        try:
            move: Move
            if goal.mode == "grasp":
                active = active_fingers(start.positions, goal.target) if goal.active is None else goal.active
                start = self._command("admittance", goal.target, goal.speed, active)
                limit = closing_limit(goal.target, active)
                move = GraspMove(start, limit, goal.speed, active, given.contact_torque, given.contact_force)
            else:
                start = self._command(
                    "position", goal.target, goal.speed, np.ones(HAND.finger_count, dtype=bool)
                )
                move = PositionMove(start, goal.target, goal.speed, given.blocked_torque)
            outcome = self._watch(move, start, on_progress, cancelled)
        except BaseException:
            self._try_to_hold()
            raise
        if outcome.code != ErrorCode.SUCCESS:
            self.stop()
        return outcome

    def stop(self) -> None:
        """Hold every joint where it was measured last. Raises DgsError HAND_SILENT or HAND_BUS."""
        self._command("hold", self.state().positions, _HOLD_SPEED, NO_FINGER)

    def _watch(
        self, move: Move, state: HandState, on_progress: OnProgress, cancelled: Callable[[], str]
    ) -> MoveOutcome:
        ticked = state
        while True:
            outcome = move.update(state)
            on_progress(state, move.progress)
            if outcome is not None:
                return outcome
            following = self._next_state(state, cancelled)
            if following is None:
                text = f"{cancelled()}; the hand holds where it is"
                return MoveOutcome(ErrorCode.HAND_CANCELLED, text, state)
            self._check_fault()
            state = following
            if state.clock > ticked.clock:
                ticked = state
            elif state.received - ticked.received > self.settings.silence_timeout:
                stands = f"the hand's clock stands still at {state.clock:.2f} s, though it sends states"
                raise DgsError(ErrorCode.HAND_SILENT, f"{stands}: no move can be timed")

    def _command(self, mode: Mode, target: ArrayLike, speed: float, active: ArrayLike) -> HandState:
        """Send a command until the hand acknowledges it; the state that does so.

        How long to wait is wall time, not a number of states: on a busy machine, or of a hand that is simulated fast,
        hundreds of older states can lie between the command and its acknowledgement.
        """
        joints = np.clip(np.asarray(target, dtype=np.float64), HAND.lower, HAND.upper)
        state = self.state()
        with self._send_lock:
            # The first one follows what the hand took last: an old acknowledgement must not pass for ours.
            last = state.accepted if self._sequence is None else self._sequence
            self._sequence = sequence = (last + 1) & 0xFF
        command = HandCommand(mode, joints, speed, np.asarray(active, dtype=bool), sequence)
        frames = self._protocol.command(command)
        patience = self.settings.silence_timeout
        begun, sends = time.monotonic(), 0
        while (waited := time.monotonic() - begun) < patience:
            if waited >= sends * _RESEND_PERIOD:
                self._send(frames)
                sends += 1
            state = self._next_state(state) or state
            if state.accepted == sequence:
                return state
        deaf = f"the hand has not taken a command that was sent {sends} times in {patience:g} s"
        raise DgsError(ErrorCode.HAND_BUS, deaf)

    def _send(self, frames: list[can.Message]) -> None:
        bus = self._bus
        try:
            with self._send_lock:
                for frame in frames:
                    bus.send(frame)
        except (can.CanError, OSError) as error:
            if bus is self._bus:
                self._lose(f"cannot send on the CAN bus: {error}")
            self._check_bus()

    def _try_to_hold(self) -> None:
        try:
            self.stop()
        except DgsError as error:
            logger.warning("the hand could not be told to hold: %s", error.message)

    def _first_state(self) -> HandState:
        """Newest state, or the first one of a bus opened a moment ago."""
        with self._news:
            self._news.wait_for(
                lambda: self._protocol.state is not None or self.lost is not None, timeout=1.0
            )
        return self.state()

    def _next_state(self, state: HandState, cancelled: Callable[[], str] = lambda: "") -> HandState | None:
        """Wait for a state newer than `state`; None when cancelled."""
        while not cancelled():
            with self._news:
                self._news.wait_for(
                    lambda: self._protocol.state is not state or self.lost is not None, timeout=_POLL
                )
            newest = self.state()
            if newest is not state:
                return newest
        return None

    def _check_bus(self) -> None:
        if self._ended.is_set():
            raise DgsError(ErrorCode.HAND_BUS, "the connection to the hand has been closed")
        if self.lost is not None:
            raise DgsError(ErrorCode.HAND_BUS, self.lost)

    def _check_fault(self) -> None:
        fault = self.fault
        if fault is not None:
            raise fault

    def _end_fault(self) -> None:
        """A new move ends the fault of the last one, where the protocol can. Raises DgsError: it stays."""
        frames = self._protocol.clear_fault()
        if frames:
            self._send(frames)
            state, told = self.state(), time.monotonic()
            while self.fault is not None and time.monotonic() - told < _FAULT_PATIENCE:
                state = self._next_state(state) or state
        self._check_fault()

    def _lose(self, reason: str) -> None:
        with self._news:
            self.lost = reason
            self._news.notify_all()

    def _run(self, settings: BusSettings) -> None:
        while not self._ended.is_set():
            try:
                bus = open_bus(settings, self._protocol.data_bitrate)
            except DgsError as error:
                if self.lost != error.message:
                    logger.warning("no connection to the hand: %s", error.message)
                self.lost = error.message
            else:
                try:
                    self._reset(bus)
                    self.lost = None
                    self._greet()
                    self._read(bus)
                except Exception as error:
                    # Anybody may write a protocol; a fault in it must not make the driver deaf.
                    logger.exception("the hand's protocol has failed")
                    self._lose(f"the hand's protocol has failed: {error}")
                with suppress(Exception):  # an adapter that was unplugged cannot be told to close
                    bus.shutdown()
                if self.lost is not None:
                    logger.warning("connection to the hand lost: %s", self.lost)
            self._ended.wait(RETRY_PERIOD)

    def _reset(self, bus: can.BusABC | None) -> None:
        """Forget what was known of the hand at the end of another bus."""
        self._bus: Any = bus
        self._protocol = self._speak(self.settings)
        self._sequence = None
        self._opened = self._last_frame = time.monotonic()

    def _read(self, bus: can.BusABC) -> None:
        while not self._ended.is_set() and self.lost is None:
            try:
                message = bus.recv(timeout=_POLL)
            except Exception as error:  # each adapter has its own, slcan's also an IndexError
                what = str(error).partition("Traceback")[0].strip()  # python-can puts one into its messages
                self._lose(f"cannot read from the CAN bus: {what}")
                return
            if message is not None:
                self._take(message)
            # On a bus with other devices there is always some frame.
            if time.monotonic() - self._last_frame > self.settings.bus_timeout:
                silence = self.settings.bus_timeout
                self._lose(f"nothing from the hand on the CAN bus for {silence:g} s; is it powered?")

    def _take(self, message: can.Message) -> None:
        before = self._protocol.state
        sound = self._protocol.receive(message)
        if sound:
            self._last_frame = time.monotonic()
        state = self._protocol.state
        if state is not None and state is not before:
            self._tell(self._protocol.follow_up())
            self._publish(state)
        elif sound:
            newest = max(self._greeted, state.received if state else 0.0)
            if self._last_frame - newest > _GREET_PERIOD:
                self._greet()

    def _greet(self) -> None:
        self._greeted = time.monotonic()
        self._tell(self._protocol.greet())

    def _tell(self, frames: list[can.Message]) -> None:
        """Send from the reader's thread, which notices a loss by itself."""
        with suppress(DgsError):
            self._send(frames)

    def _publish(self, state: HandState) -> None:
        with self._news:
            self._news.notify_all()
        try:
            self._on_state(state)
        except Exception:
            # A listener's fault must not make the driver deaf.
            logger.exception("the listener for hand states failed")

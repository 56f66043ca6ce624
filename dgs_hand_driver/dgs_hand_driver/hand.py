"""The DexHand Pro at the end of a CAN bus: connection, newest state, moves, stop. ROS-free."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
from numpy.typing import ArrayLike

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import FINGERS, HAND_LOWER, HAND_UPPER
from dgs_description.parameters import parameter
from dgs_description.pick import closing_limit
from dgs_hand_driver.admittance import active_fingers
from dgs_hand_driver.bus import BusSettings, open_bus
from dgs_hand_driver.can_protocol import FaultFrame, FingerFrame, HandProtocol, Mode, ModeFrame, StatusFrame
from dgs_hand_driver.hand_state import HandState, StateAssembler
from dgs_hand_driver.move_goal import MoveGoal
from dgs_hand_driver.move_monitor import (
    BLOCKED_TORQUE,
    CONTACT_TORQUE,
    GraspMove,
    Move,
    MoveOutcome,
    PositionMove,
    Triple,
)

logger = logging.getLogger(__name__)

OnProgress = Callable[[HandState, float], None]
Five = tuple[float, float, float, float, float]
"""Of thumb, index, middle, ring, little."""

RETRY_PERIOD = 0.5
"""Pause before a bus that could not be opened, or was lost, is tried again [s]."""
_POLL = 0.1
"""How long the reader waits for a frame before it looks whether it shall end [s]."""
_RESEND_CYCLES = 5
"""States without acknowledgement before a command is sent again."""
_MAX_SENDS = 10
_HOLD_SPEED = 1.0
"""A hold moves nothing, but its frame has the field [rad/s]."""
_FAULT_MEMORY = 1.0
"""A fault is repeated with every heartbeat; without repetition it is over [s]."""


@dataclass(frozen=True)
class HandSettings:
    """How the driver treats the hand. Fives are thumb ... little, triples yaw, pitch, middle (with distal)."""

    # A simulator that renders makes pauses.
    silence_timeout: float = parameter(5.0, "Wall time without joint states [s].", 0.1, 60.0)
    bus_timeout: float = 3.0
    """wall time without any frame, 30 heartbeats, after which the connection counts as lost [s]"""
    # Some hands command and measure yaw in opposite directions.
    yaw_command_signs: Five = parameter(
        (1.0,) * 5, "Direction of the commanded yaw of every finger on this hand.", choices=(1.0, -1.0)
    )
    yaw_state_signs: Five = parameter(
        (1.0,) * 5, "Direction of the measured yaw of every finger on this hand.", choices=(1.0, -1.0)
    )
    blocked_torque: Triple = parameter(BLOCKED_TORQUE, "Unexpected contact in position mode [Nm].", 0.01, 5.0)
    contact_torque: Triple = parameter(
        CONTACT_TORQUE, "Contact of a closing finger; yaw says nothing [Nm].", 0.01, 5.0
    )


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
        protocol: HandProtocol | None = None,
        on_state: Callable[[HandState], None] = lambda _: None,
    ) -> None:
        """Begin to connect; `on_state` is called in the reader's thread with every state."""
        self.settings = settings or HandSettings()
        self._protocol = protocol or HandProtocol()
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
        with self._news:
            self._news.notify_all()
        self._reader.join()

    @property
    def incomplete_cycles(self) -> int:
        """States dropped because a frame was lost or damaged."""
        return self._assembler.incomplete

    @property
    def fault(self) -> str | None:
        """The fault that the hand reports at present, as a sentence."""
        fault = self._fault
        if fault is None or fault[1].fault == "none" or time.monotonic() - fault[0] > _FAULT_MEMORY:
            return None
        fingers = [name for name, hit in zip(FINGERS, fault[1].fingers, strict=True) if hit]
        return f"the hand reports {fault[1].fault}" + (f" of {', '.join(fingers)}" if fingers else "")

    def state(self) -> HandState:
        """Newest state. Raises DgsError HAND_BUS: connection lost; HAND_SILENT: no state, or only an old one."""
        self._check_bus()
        state = self._state
        age = time.monotonic() - (state.received if state else self._opened)
        if state is None or age > self.settings.silence_timeout:
            silent = f"no joint states from the hand for {age:.1f} s although the CAN bus is open"
            raise DgsError(ErrorCode.HAND_SILENT, f"{silent}; is the hand powered?")
        return state

    def move(
        self,
        goal: MoveGoal,
        on_progress: OnProgress = lambda state, progress: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> MoveOutcome:
        """Move the hand and wait for the end.

        A move to positions that meets something, runs late or is cancelled leaves the hand holding where it is.
        A grasp adds the closing margin to the fingers that close; its success leaves the hand squeezing.

        Args:
            on_progress: called with every state and the progress 0..1.
            cancelled: asked at every state, and every 0.1 s while there is none.

        Raises:
            DgsError: HAND_SILENT, HAND_BUS, or HAND_INTERNAL when the hand reports a fault.
        """
        given = self.settings
        start = self._first_state()
        self._check_fault()
        try:
            move: Move
            if goal.mode == "grasp":
                active = active_fingers(start.positions, goal.target) if goal.active is None else goal.active
                start = self._command("admittance", goal.target, goal.speed, active)
                limit = closing_limit(goal.target, active)
                move = GraspMove(start, limit, goal.speed, active, given.contact_torque)
            else:
                start = self._command("position", goal.target, goal.speed, np.ones(5, dtype=bool))
                move = PositionMove(start, goal.target, goal.speed, given.blocked_torque)
            outcome = self._watch(move, start, on_progress, cancelled)
        except DgsError:
            self._try_to_hold()
            raise
        if outcome.code != ErrorCode.SUCCESS:
            self.stop()
        return outcome

    def stop(self) -> None:
        """Hold every joint where it was measured last. Raises DgsError HAND_SILENT or HAND_BUS."""
        self._command("hold", self.state().positions, _HOLD_SPEED, np.zeros(5, dtype=bool))

    def _watch(
        self, move: Move, state: HandState, on_progress: OnProgress, cancelled: Callable[[], bool]
    ) -> MoveOutcome:
        while True:
            outcome = move.update(state)
            on_progress(state, move.progress)
            if outcome is not None:
                return outcome
            following = self._next_state(state, cancelled)
            if following is None:
                return MoveOutcome(ErrorCode.HAND_CANCELLED, "cancelled; the hand holds where it is", state)
            self._check_fault()
            state = following

    def _command(self, mode: Mode, target: ArrayLike, speed: float, active: ArrayLike) -> HandState:
        """Send a command until the hand acknowledges it; the state that does so."""
        joints = np.clip(np.asarray(target, dtype=np.float64), HAND_LOWER, HAND_UPPER).reshape(5, 4)
        joints[:, 0] *= self.settings.yaw_command_signs
        state = self.state()
        with self._send_lock:
            # The first one follows what the hand took last: an old acknowledgement must not pass for ours.
            last = state.accepted if self._sequence is None else self._sequence
            self._sequence = sequence = (last + 1) & 0xFF
        frames = self._protocol.encode_command(mode, joints, speed, active, sequence)
        for _ in range(_MAX_SENDS):
            self._send(frames)
            for _ in range(_RESEND_CYCLES):
                state = self._next_state(state) or state
                if state.accepted == sequence:
                    return state
        deaf = f"the hand has not taken a command that was sent {_MAX_SENDS} times"
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
            self._news.wait_for(lambda: self._state is not None or self.lost is not None, timeout=1.0)
        return self.state()

    def _next_state(
        self, state: HandState, cancelled: Callable[[], bool] = lambda: False
    ) -> HandState | None:
        """Wait for a state newer than `state`; None when cancelled."""
        while not cancelled():
            with self._news:
                self._news.wait_for(lambda: self._state is not state or self.lost is not None, timeout=_POLL)
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
            raise DgsError(ErrorCode.HAND_INTERNAL, fault)

    def _lose(self, reason: str) -> None:
        with self._news:
            self.lost = self.lost or reason
            self._news.notify_all()

    def _run(self, settings: BusSettings) -> None:
        while not self._ended.is_set():
            try:
                bus = open_bus(settings)
            except DgsError as error:
                self.lost = error.message
            else:
                self._reset(bus)
                self.lost = None
                self._read(bus)
                bus.shutdown()
                if self.lost is not None:
                    logger.warning("connection to the hand lost: %s", self.lost)
            self._ended.wait(RETRY_PERIOD)

    def _reset(self, bus: can.BusABC | None) -> None:
        """Forget what was known of the hand at the end of another bus."""
        self._bus: Any = bus
        self._assembler = StateAssembler(self.settings.yaw_state_signs)
        self._state: HandState | None = None
        self._fault: tuple[float, FaultFrame] | None = None
        self._sequence = None
        self._opened = self._last_frame = time.monotonic()

    def _read(self, bus: can.BusABC) -> None:
        while not self._ended.is_set() and self.lost is None:
            try:
                message = bus.recv(timeout=_POLL)
            except (can.CanError, OSError, ValueError) as error:
                self._lose(f"cannot read from the CAN bus: {error}")
                return
            if message is not None:
                self._take(message)
            elif time.monotonic() - self._last_frame > self.settings.bus_timeout:
                silence = self.settings.bus_timeout
                self._lose(f"nothing on the CAN bus for {silence:g} s; is the hand powered?")

    def _take(self, message: can.Message) -> None:
        frame = self._protocol.decode(message)
        if isinstance(frame, FaultFrame):
            self._fault = (time.monotonic(), frame)
        elif isinstance(frame, (FingerFrame, StatusFrame)):
            state = self._assembler.add(frame)
            if state is not None:
                self._publish(state)
        if frame is not None and not isinstance(frame, ModeFrame):
            self._last_frame = time.monotonic()

    def _publish(self, state: HandState) -> None:
        with self._news:
            self._state = state
            self._news.notify_all()
        try:
            self._on_state(state)
        except Exception:
            # A listener's fault must not make the driver deaf.
            logger.exception("the listener for hand states failed")

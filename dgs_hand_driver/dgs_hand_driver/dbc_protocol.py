"""The suite's own protocol, described by a DBC: both ends of the wire. docs/hand_can_protocol.md explains it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from itertools import compress

import can
import numpy as np

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_hand_driver.dbc_codec import (
    CLOCK_RANGE,
    DbcCodec,
    FaultFrame,
    FingerFrame,
    HeartbeatFrame,
    ModeFrame,
    StatusFrame,
    expand_positions,
    expand_torques,
)
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand, HandState
from dgs_hand_driver.protocol import NO_FINGER, HandFirmware, HandProtocol

MAX_STEP = 60.0
"""A longer step of the clock is a restart [s]."""
FAULT_MEMORY = 1.0
"""A fault is repeated with every heartbeat; without repetition it is over [s]."""


class DbcFirmware(HandFirmware):
    """Acknowledges complete commands, repeats a fault with every heartbeat."""

    def __init__(self) -> None:
        super().__init__()
        self._codec = DbcCodec()
        self._pending: dict[int, FingerFrame] = {}
        self._accepted: tuple[bytes, int] = (b"", 0)
        self._cycle = 0
        self._beats = 0
        self._fault: tuple[str, Sequence[bool]] = ("none", NO_FINGER)

    def receive(self, message: can.Message) -> list[can.Message]:
        """See `HandFirmware`."""
        frame = self._codec.decode(message)
        if isinstance(frame, FingerFrame) and frame.kind == "command":
            self._pending[frame.finger] = frame
        elif isinstance(frame, ModeFrame):
            self._commit(frame, bytes(message.data))
        return []

    def state(self, positions: Array, torques: Array, forces: Array, clock: float) -> list[can.Message]:
        """See `HandFirmware`; the forces have no place in this protocol."""
        self._cycle = (self._cycle + 1) & 0xFF
        mode, accepted = self.command.mode, self._accepted[1]
        return self._codec.encode_state(positions, torques, mode, accepted, clock, self._cycle)

    def inject(self, fault: str, fingers: Sequence[bool]) -> list[can.Message]:
        """See `HandFirmware`; a fault of the DBC's table."""
        frame = self._codec.encode_fault(fault, fingers, 0)
        self._fault = (fault, fingers)
        return [frame]

    def beat(self, uptime: float) -> list[can.Message]:
        """Heartbeat, and the fault while there is one."""
        self._beats = (self._beats + 1) & 0xFF
        frames = [self._codec.encode_heartbeat(uptime, self._beats)]
        if self._fault[0] != "none":
            frames.append(self._codec.encode_fault(*self._fault, self._beats))
        return frames

    def _commit(self, frame: ModeFrame, data: bytes) -> None:
        pending = [self._pending[finger] for finger in sorted(self._pending)]
        values = [finger.values for finger in pending if finger.sequence == frame.sequence]
        if len(values) < HAND.finger_count:
            return  # a frame was lost: no acknowledgement, so the driver sends the command again
        target = np.clip(expand_positions(values), HAND.lower, HAND.upper)
        content = data + np.asarray(values).tobytes()
        if self._accepted[0] == content:
            return  # sent again although it had come: taken only once
        self._accepted = (content, frame.sequence)
        active, number = np.array(frame.active), self.command.sequence + 1
        self.command = HandCommand(frame.mode, target, frame.speed, active, number)


class DbcProtocol(HandProtocol):
    """Sends a command once; the hand carries it out, with its own admittance control, and acknowledges it."""

    firmware = DbcFirmware

    def __init__(self, settings: HandSettings) -> None:
        """Read the DBC. Raises DgsError as `DbcCodec`, or PARAMETER_INVALID: not a sign for every finger."""
        super().__init__(settings)
        for signs in (settings.yaw_command_signs, settings.yaw_state_signs):
            if len(signs) != HAND.finger_count:
                wrong = f"yaw signs must be {HAND.finger_count}, one a finger, got {len(signs)}"
                raise DgsError(ErrorCode.PARAMETER_INVALID, wrong)
        self._codec = DbcCodec(settings.dbc)
        self._signs = np.ones((HAND.finger_count, 3))
        self._signs[:, 0] = settings.yaw_state_signs
        self._frames: dict[tuple[str, int], FingerFrame] = {}
        self._status: StatusFrame | None = None
        self._last_clock: float | None = None
        self._clock = 0.0
        self._fault: tuple[float, FaultFrame] | None = None

    def command(self, command: HandCommand) -> list[can.Message]:
        """Five finger frames and the mode frame."""
        joints = HAND.split(command.target).copy()
        joints[:, 0] *= self.settings.yaw_command_signs
        return self._codec.encode_command(
            command.mode, joints, command.speed, command.active, command.sequence
        )

    def receive(self, message: can.Message) -> bool:
        """See `HandProtocol`."""
        frame = self._codec.decode(message)
        if isinstance(frame, FaultFrame):
            self._fault = (time.monotonic(), frame)
        elif isinstance(frame, FingerFrame) and frame.kind != "command":
            self._frames[frame.kind, frame.finger] = frame
            self._complete()
        elif isinstance(frame, StatusFrame):
            self.incomplete += self._status is not None
            self._status = frame
            self._complete()
        else:
            return isinstance(frame, HeartbeatFrame)
        return True

    @property
    def fault(self) -> DgsError | None:
        """See `HandProtocol`."""
        fault = self._fault
        if fault is None or fault[1].fault == "none" or time.monotonic() - fault[0] > FAULT_MEMORY:
            return None
        of = f" of {', '.join(compress(HAND.fingers, fault[1].fingers))}" if any(fault[1].fingers) else ""
        return DgsError(ErrorCode.HAND_INTERNAL, f"the hand reports {fault[1].fault}{of}")

    @property
    def absent(self) -> str:
        """See `HandProtocol`; fingers without a frame since the last complete cycle."""
        heard = self._frames.copy().keys()
        whole = [{("position", k), ("torque", k)} <= heard for k in range(HAND.finger_count)]
        return ", ".join(name for name, there in zip(HAND.fingers, whole, strict=True) if heard and not there)

    def _complete(self) -> None:
        """The state of a cycle, once its eleven frames are there: on its way, a status frame may overtake the others.

        One that lacks a frame is dropped by the next one's status frame, and counted.
        """
        status, rows = self._status, {}
        if status is None:
            return
        for kind in ("position", "torque"):
            frames = [self._frames.get((kind, finger)) for finger in range(HAND.finger_count)]
            rows[kind] = [f.values for f in frames if f is not None and f.sequence == status.sequence]
            if len(rows[kind]) < HAND.finger_count:
                return
        self._status = None
        self._frames.clear()  # the numbers come round: an old frame must not pass for one of a later cycle
        self._advance(status.clock)
        self.state = HandState(
            positions=expand_positions(np.array(rows["position"]) * self._signs),
            torques=expand_torques(np.array(rows["torque"]) * self._signs),
            mode=status.mode,
            accepted=status.accepted,
            clock=self._clock,
            received=time.monotonic(),
            cycle=(self.state.cycle if self.state else 0) + 1,
        )

    def _advance(self, clock: float) -> None:
        # The clock wraps after 50 days and starts anew with the hand or the simulator: durations must not jump then.
        if self._last_clock is not None:
            step = (clock - self._last_clock) % CLOCK_RANGE
            if step < MAX_STEP:
                self._clock += step
        self._last_clock = clock

"""CAN frames of the hand <-> numbers, by the DBC file; docs/hand_can_protocol.md describes the protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args

import can
import cantools
import numpy as np
from cantools.database.can import Database, Message
from crccheck.crc import Crc8SaeJ1850
from numpy.typing import ArrayLike

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_hand_driver.hand_state import Mode

Kind = Literal["command", "position", "torque"]

DBC_NAME = "dexhand.dbc"
CLOCK_RANGE = 2**32 * 1e-3
"""The hand's clock starts again from zero here [s]."""
_ACTIVE_SIGNALS = ("Yaw", "Pitch", "Middle")


@dataclass(frozen=True)
class ModeFrame:
    """Closes a command, speed in [rad/s]; valid once the five finger frames of the same sequence are there."""

    mode: Mode
    active: tuple[bool, ...]
    speed: float
    sequence: int


@dataclass(frozen=True)
class FingerFrame:
    """Three numbers of one finger: yaw, pitch, middle. Targets and positions [rad], torques [Nm]."""

    kind: Kind
    finger: int
    values: tuple[float, float, float]
    sequence: int


@dataclass(frozen=True)
class StatusFrame:
    """Closes one cycle of state frames."""

    mode: Mode
    accepted: int
    """Sequence of the newest command that the hand has taken."""
    clock: float
    """Of the hand, when it measured [s]."""
    sequence: int


@dataclass(frozen=True)
class FaultFrame:
    """The hand cannot do its work."""

    fault: str
    """"none" when it is over."""
    fingers: tuple[bool, ...]
    sequence: int


@dataclass(frozen=True)
class HeartbeatFrame:
    """The hand is alive; uptime in [s]."""

    uptime: float
    protocol: int
    sequence: int


Frame = ModeFrame | FingerFrame | StatusFrame | FaultFrame | HeartbeatFrame


class DbcCodec:
    """Encodes and decodes every frame of the hand.

    The numbers of the bits stand in the DBC alone: identifiers, bit positions, scaling and value tables can be changed
    there without touching code as long as the names of messages and signals stay. A message without a signal `Crc` is
    not checked.
    """

    def __init__(self, dbc: Path | str = "") -> None:
        """Read a DBC file; "" = the package's.

        Raises:
            DgsError: PARAMETER_INVALID, unreadable or incomplete; HAND_PROTOCOL, it cannot describe this hand.
        """
        if not HAND.coupled.all():
            free = f"the DBC protocol has no place for the fourth motor of a finger, which {HAND.name} has"
            raise DgsError(ErrorCode.HAND_PROTOCOL, free)
        try:
            text = Path(dbc).read_text() if dbc else (resources.files(__package__) / DBC_NAME).read_text()
            database = cantools.database.load_string(text, "dbc")
        except (OSError, cantools.database.Error, UnicodeDecodeError) as error:
            unreadable = f"cannot read the CAN database {dbc or DBC_NAME}: {error}"
            raise DgsError(ErrorCode.PARAMETER_INVALID, unreadable) from error
        if not isinstance(database, Database):
            raise DgsError(ErrorCode.PARAMETER_INVALID, f"{dbc or DBC_NAME} is not a CAN database")
        self._mode = _message(database, "HandMode", "Mode", "Fingers", "Speed", "Sequence")
        self._status = _message(database, "HandStatus", "Mode", "Accepted", "Clock", "Sequence")
        self._fault = _message(database, "HandFault", "Fault", "Fingers", "Sequence")
        for message in (self._mode, self._status):
            _check_names(message, "Mode", get_args(Mode))
        _check_names(self._fault, "Fault", ["none"])
        self._heartbeat = _message(database, "HandHeartbeat", "Uptime", "Protocol", "Sequence")
        self._finger = {
            (kind, index): _message(database, f"{name.title()}{kind.title()}", *_ACTIVE_SIGNALS, "Sequence")
            for kind in get_args(Kind)
            for index, name in enumerate(HAND.fingers)
        }
        self._finger_by_id = {message.frame_id: key for key, message in self._finger.items()}
        all_messages = (self._mode, self._status, self._fault, self._heartbeat, *self._finger.values())
        self._by_id = {message.frame_id: message for message in all_messages}

    def encode_command(
        self, mode: Mode, target: ArrayLike, speed: float, active: ArrayLike, sequence: int
    ) -> list[can.Message]:
        """Frames of one command: five finger frames, then the mode frame that makes it valid.

        Args:
            mode: what the hand shall do with the targets.
            target: (J,) joints [rad]; joint4 is not sent, it follows joint3.
            speed: limit of every joint [rad/s].
            active: (F,) fingers that comply in admittance mode.
            sequence: 0..255, the same for all six frames.
        """
        frames = self._encode_fingers("command", HAND.split(np.asarray(target))[:, :3], sequence)
        fingers = _pack_fingers(active)
        limited = _within(self._mode, "Speed", float(speed))
        signals = {"Mode": mode, "Fingers": fingers, "Speed": limited, "Sequence": sequence}
        return [*frames, _encode(self._mode, signals)]

    def encode_state(
        self, positions: ArrayLike, torques: ArrayLike, mode: Mode, accepted: int, clock: float, sequence: int
    ) -> list[can.Message]:
        """Frames of one cycle: five position frames, five torque frames, and the status frame that closes them.

        Args:
            positions: (J,) measured joints [rad].
            torques: (J,) of the drives, positive in closing direction [Nm]; joints 3 and 4 of a finger hang on one
                drive, so their sum is sent.
            clock: the hand's time of the measurement [s], wraps at `CLOCK_RANGE`.
            sequence: 0..255, the same for all eleven frames.
        """
        torque = HAND.split(np.asarray(torques, dtype=np.float64))
        drive = np.column_stack([torque[:, 0], torque[:, 1], torque[:, 2] + torque[:, 3]])
        signals = {"Mode": mode, "Accepted": accepted, "Clock": clock % CLOCK_RANGE, "Sequence": sequence}
        return [
            *self._encode_fingers("position", HAND.split(np.asarray(positions))[:, :3], sequence),
            *self._encode_fingers("torque", drive, sequence),
            _encode(self._status, signals),
        ]

    def encode_fault(self, fault: str, fingers: ArrayLike, sequence: int) -> can.Message:
        """Fault frame; `fault` is a name of the DBC's value table, "none" when it is over. Raises ValueError."""
        if fault not in self.faults:
            raise ValueError(f"unknown fault {fault!r}; the hand knows {', '.join(self.faults)}")
        return _encode(self._fault, {"Fault": fault, "Fingers": _pack_fingers(fingers), "Sequence": sequence})

    def encode_heartbeat(self, uptime: float, sequence: int) -> can.Message:
        """Heartbeat frame; `uptime` in [s]."""
        return _encode(self._heartbeat, {"Uptime": uptime % CLOCK_RANGE, "Protocol": 1, "Sequence": sequence})

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the faults that the hand can report."""
        return _names(self._fault, "Fault")

    def decode(self, frame: can.Message) -> Frame | None:
        """What a received frame says; None for a frame that is not the hand's or whose checksum is wrong."""
        message = self._by_id.get(frame.arbitration_id)
        if message is None or frame.is_extended_id != message.is_extended_frame:
            return None
        if frame.is_error_frame or frame.is_remote_frame or len(frame.data) != message.length:
            return None
        if not _crc_matches(message, frame.data):
            return None
        values: Mapping[str, Any] = message.decode(bytes(frame.data))  # type: ignore[assignment]
        return self._interpret(message, values)

    def _interpret(self, message: Message, values: Mapping[str, Any]) -> Frame | None:
        # A value that has a name in the file comes with it.
        number = {name: float(getattr(value, "value", value)) for name, value in values.items()}
        sequence = int(number["Sequence"])
        if message.frame_id in self._finger_by_id:
            kind, finger = self._finger_by_id[message.frame_id]
            return FingerFrame(kind, finger, (number["Yaw"], number["Pitch"], number["Middle"]), sequence)
        if message is self._heartbeat:
            return HeartbeatFrame(number["Uptime"], int(number["Protocol"]), sequence)
        if message is self._fault:
            return FaultFrame(str(values["Fault"]), _unpack_fingers(number["Fingers"]), sequence)
        mode = str(values["Mode"])
        if mode not in get_args(Mode):
            return None
        if message is self._status:
            return StatusFrame(mode, int(number["Accepted"]), number["Clock"], sequence)  # type: ignore[arg-type]
        return ModeFrame(mode, _unpack_fingers(number["Fingers"]), number["Speed"], sequence)  # type: ignore[arg-type]

    def _encode_fingers(self, kind: Kind, values: Array, sequence: int) -> list[can.Message]:
        frames = []
        for finger, triple in enumerate(values):
            message = self._finger[kind, finger]
            signals: dict[str, object] = {"Sequence": sequence}
            for name, value in zip(_ACTIVE_SIGNALS, triple, strict=True):
                signals[name] = _within(message, name, float(value))
            frames.append(_encode(message, signals))
        return frames


def expand_positions(rows: ArrayLike) -> Array:
    """(F, 3) yaw, pitch, middle of every finger -> (J,) joints, distal = middle [rad]."""
    joints = np.asarray(rows, dtype=np.float64).reshape(HAND.finger_count, 3)
    return HAND.expand(HAND.reduce(joints[:, [0, 1, 2, 2]].reshape(HAND.joint_count)))


def expand_torques(rows: ArrayLike) -> Array:
    """(F, 3) drive torques -> (J,): the coupled pair has one drive, which stands at joint3; joint4 has none [Nm]."""
    drive = np.asarray(rows, dtype=np.float64).reshape(HAND.finger_count, 3)
    return np.column_stack([drive, np.zeros(HAND.finger_count)]).reshape(HAND.joint_count)


def _checksum(message: Message, data: bytes | bytearray) -> int:
    # The identifier is part of the checksum: a frame under a wrong name must not pass.
    return int(Crc8SaeJ1850.calc(message.frame_id.to_bytes(4, "big") + bytes(data)))


def _crc_byte(message: Message) -> int | None:
    # The checksum is a whole byte; None: this message has none.
    starts = [signal.start for signal in message.signals if signal.name == "Crc"]
    return starts[0] // 8 if starts else None


def _encode(message: Message, signals: Mapping[str, object]) -> can.Message:
    place = _crc_byte(message)
    values = dict(signals) if place is None else {**signals, "Crc": 0}
    data = bytearray(message.encode(values))  # type: ignore[arg-type]
    if place is not None:
        data[place] = _checksum(message, data)
    return can.Message(arbitration_id=message.frame_id, data=data, is_extended_id=message.is_extended_frame)


def _crc_matches(message: Message, data: bytearray) -> bool:
    place = _crc_byte(message)
    if place is None:
        return True
    blank = bytearray(data)
    blank[place] = 0
    return _checksum(message, blank) == data[place]


def _within(message: Message, signal_name: str, value: float) -> float:
    # What lies outside a signal's range is sent as the range's end: a wrapped integer would be a wild command.
    signal = message.get_signal_by_name(signal_name)
    low = value if signal.minimum is None else float(signal.minimum)
    high = value if signal.maximum is None else float(signal.maximum)
    return min(max(value, low), high)


def _message(database: Database, name: str, *signals: str) -> Message:
    try:
        message = database.get_message_by_name(name)
        for signal in signals:
            message.get_signal_by_name(signal)
    except KeyError as error:
        needs = f"message {name} with the signals {', '.join(signals)}"
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"the CAN database lacks {needs} ({error})") from error
    return message


def _names(message: Message, signal: str) -> tuple[str, ...]:
    choices: Mapping = message.get_signal_by_name(signal).choices or {}
    return tuple(str(name) for name in choices.values())


def _check_names(message: Message, signal: str, needed: Sequence[str]) -> None:
    missing = ", ".join(sorted(set(needed) - set(_names(message, signal))))
    if missing:
        unnamed = f"the CAN database names no value of {message.name}'s {signal} {missing}"
        raise DgsError(ErrorCode.PARAMETER_INVALID, unnamed)


def _pack_fingers(fingers: ArrayLike) -> int:
    flags = np.asarray(fingers, dtype=bool).reshape(HAND.finger_count)
    return sum(1 << k for k in range(HAND.finger_count) if flags[k])


def _unpack_fingers(bits: float) -> tuple[bool, ...]:
    return tuple(bool(int(bits) >> k & 1) for k in range(HAND.finger_count))

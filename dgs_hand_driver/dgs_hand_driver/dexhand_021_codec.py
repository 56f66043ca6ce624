"""Frames of the DexRobot DexHand 021, right hand: CAN FD with 11-bit identifiers, little-endian.

Facts (identifiers, layouts, units, error bits) from the maker's driver, DexRobot/pyzlg_dexhand, Apache-2.0. Six boards
drive two motors each; a frame's identifier is a base plus the board's number.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Literal

import can
import numpy as np
from numpy.typing import ArrayLike

FIRST_BOARD, BOARDS = 7, 6
"""Of the right hand; the left one's are 1 to 6."""
MOTORS = (
    ("thumb_joint3", 1), ("thumb_joint2", 1),
    ("thumb_joint1", -1), ("index_joint1", -1),
    ("index_joint3", 1), ("index_joint2", 1),
    ("middle_joint3", 1), ("middle_joint2", 1),
    ("ring_joint3", 1), ("ring_joint2", 1),
    ("little_joint3", 1), ("little_joint2", 1),
)  # fmt: skip
"""Joint of every motor, two a board, and its direction: the maker counts turning and spreading from zero upwards."""
TACTILE_BOARDS = (0, 2, 3, 4, 5)
"""That read the fingertips of thumb, index, middle, ring, little."""
TORQUE_PER_AMPERE = 1.0
"""Of a motor at its joint [Nm/A]. [own] The maker states none: measure it, all torques scale with it."""
POSITION_MODE = 0x44
"""The maker's cascaded control: the target is an angle, in 0.01 degrees."""
PERIODIC = 0x01
ERRORS = {"over_current": 1, "joint_sensor": 2, "stall": 4, "parameter": 8}
"""Bits of a board's first motor; the second one's stand four bits higher."""

Kind = Literal["command", "setting", "feedback", "answer", "error"]
_BASES: dict[int, Kind] = {
    0x100: "command",
    0x000: "setting",
    0x180: "feedback",
    0x080: "answer",
    0x600: "error",
}
_BASE_OF = {kind: base for base, kind in _BASES.items()}
_CLEAR, _FEEDBACK = b"\x03\xa4", b"\x03\x74"
_DONE = b"\x00\x01"
_MOTION = struct.Struct("<BBhh")
_DRIVES = struct.Struct("<8h")
"""Current [mA], speed [rpm] and position [counts] of both motors, then the angles of their joints [0.01 degrees]."""
_TACTILE = struct.Struct("<fIfIHII")
"""Normal force [N] and its change, tangential force [N] and its change, direction, proximity, temperature [C]."""
Pair = tuple[float, float]


@dataclass(frozen=True)
class BoardState:
    """What one board measures."""

    angles: Pair
    """of its joints, as the maker counts them [rad]"""
    torques: Pair
    """[Nm]"""
    forces: Pair | None = None
    """normal and tangential on the fingertip [N], NaN where the sensor says nothing; None: it has no sensor"""


def encode_motion(angles: ArrayLike) -> list[can.Message]:
    """Targets of all motors, (12,) as the maker counts [rad]: a frame for every board."""
    limit = 2**15 - 1
    counts = np.clip(np.rint(np.degrees(angles) * 100), -limit, limit).astype(int).reshape(BOARDS, 2)
    return [
        _frame("command", board, _MOTION.pack(POSITION_MODE, 0x03, *pair))
        for board, pair in enumerate(counts.tolist())
    ]


def decode_motion(message: can.Message) -> tuple[int, Pair] | None:
    """Board and targets [rad] of a command in position mode; None: something else."""
    kind, board = address(message)
    if kind != "command" or len(message.data) < _MOTION.size:
        return None
    mode, enabled, first, second = _MOTION.unpack_from(message.data)
    if mode != POSITION_MODE or enabled != 0x03:
        return None
    return board, (math.radians(first / 100), math.radians(second / 100))


def encode_reporting(period: float) -> list[can.Message]:
    """Have every board report each `period`, a multiple of 0.01 s."""
    setting = _FEEDBACK + bytes([PERIODIC, round(period / 0.01), 1])
    return [_frame("setting", board, setting) for board in range(BOARDS)]


def encode_clear(board: int) -> can.Message:
    """Have a board end its errors."""
    return _frame("setting", board, _CLEAR)


def encode_done(message: can.Message) -> can.Message:
    """A board's answer to a setting."""
    return _frame("answer", address(message)[1], bytes(message.data[:2]) + _DONE)


def encode_state(board: int, state: BoardState) -> can.Message:
    """What a board reports, as 64 bytes; speeds, encoders and the other figures of the fingertip are left at zero."""
    currents = [round(1000 * torque / TORQUE_PER_AMPERE) for torque in state.torques]
    angles = [round(100 * math.degrees(angle)) for angle in state.angles]
    data = _DRIVES.pack(currents[0], 0, 0, currents[1], 0, 0, *angles)
    if state.forces is not None:
        data += _TACTILE.pack(state.forces[0], 0, state.forces[1], 0, 0, 0, 25)
    return _frame("feedback", board, data.ljust(64, b"\0"))


def encode_error(board: int, bits: int) -> can.Message:
    """What a board says when a motor fails; `bits` of `ERRORS`."""
    motors = (1 if bits & 0x0F else 0) | (2 if bits & 0xF0 else 0)
    return _frame("error", board, bytes([0xEE, motors, bits]))


def decode(message: can.Message) -> tuple[int, BoardState | int] | None:
    """Board and what it measures, or bits of `ERRORS` of both motors, 0 once it has ended its errors.

    None for what is not the hand's, or damaged.
    """
    kind, board = address(message)
    data = bytes(message.data)
    if kind == "feedback" and len(data) >= _DRIVES.size:
        return board, _board_state(board, data)
    if kind == "error" and len(data) >= 3 and data[0] == 0xEE and data[2]:
        return board, data[2]
    if kind == "answer" and data[:4] == _CLEAR + _DONE:
        return board, 0
    return None


def address(message: can.Message) -> tuple[Kind | None, int]:
    """What kind of frame it is, and the board, from 0; no kind: not one of this hand."""
    # Whether a frame is an FD one is not asked: python-can's socketcand client loses it.
    kind, board = _BASES.get(message.arbitration_id & ~0x7F), (message.arbitration_id & 0x7F) - FIRST_BOARD
    foreign = message.is_extended_id or message.is_error_frame or message.is_remote_frame
    return (None if foreign or not 0 <= board < BOARDS else kind), board


def is_clear(message: can.Message) -> bool:
    """Whether a setting asks to end errors."""
    return bytes(message.data[:2]) == _CLEAR


def starts_reporting(message: can.Message) -> bool:
    """Whether a setting asks for periodic reports."""
    data = bytes(message.data)
    return data[:3] == _FEEDBACK + bytes([PERIODIC]) and data[4:5] == b"\x01"


def _board_state(board: int, data: bytes) -> BoardState:
    first, _, _, second, _, _, *angles = _DRIVES.unpack_from(data)
    forces = None
    if board in TACTILE_BOARDS and len(data) >= _DRIVES.size + _TACTILE.size:
        normal, _, tangential, *_ = _TACTILE.unpack_from(data, _DRIVES.size)
        forces = (normal, tangential)
    return BoardState(
        (math.radians(angles[0] / 100), math.radians(angles[1] / 100)),
        (first * TORQUE_PER_AMPERE / 1000, second * TORQUE_PER_AMPERE / 1000),
        forces,
    )


def _frame(kind: Kind, board: int, data: bytes) -> can.Message:
    identifier = _BASE_OF[kind] + FIRST_BOARD + board
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False, is_fd=True, check=True)

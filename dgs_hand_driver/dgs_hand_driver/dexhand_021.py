"""The protocol of the DexRobot DexHand 021: both ends of the wire. Its frames: `dexhand_021_codec`.

The boards go to angles and nothing else. Speed, admittance control and the clock of a move are the driver's: it sends
all targets anew after every cycle.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import can
import numpy as np

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_hand_driver import dexhand_021_codec as codec
from dgs_hand_driver.dexhand_021_codec import BOARDS, ERRORS, MOTORS, TACTILE_BOARDS, BoardState, Pair
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import STATE_PERIOD, HandCommand, HandState
from dgs_hand_driver.protocol import HandFirmware, HandProtocol
from dgs_hand_driver.set_points import SetPoints

LEAD, LEAD_STIFFNESS = 0.15, 5.0
"""[own] A set point is ahead of its joint by at most the first [rad], and what the joint's torque takes at the second
[Nm/rad], less than any motor has: cycles that waited while the driver paused must not become a jump."""
_STALL = ERRORS["stall"] | ERRORS["stall"] << 4


class _Wiring:
    """Which joint hangs on which motor."""

    def __init__(self) -> None:
        if {name for name, _ in MOTORS} != set(HAND.driven_joints):
            other = f"DexHand021 drives {len(MOTORS)} joints of a DexHand 021, not those of {HAND.name}"
            raise DgsError(ErrorCode.HAND_PROTOCOL, other)
        self._rows = np.array([HAND.joints.index(name) for name, _ in MOTORS])
        self._signs = np.array([sign for _, sign in MOTORS], dtype=np.float64)

    def angles(self, joints: Array) -> Array:
        """(12,) of the motors, of (J,) joints [rad]."""
        return joints[self._rows] * self._signs

    def joints(self, angles: Array) -> Array:
        """(J,) of (12,) [rad]: what hangs on the same motor follows."""
        values = np.zeros(HAND.joint_count)
        values[self._rows] = angles * self._signs
        return HAND.expand(HAND.reduce(values))

    def motor_torques(self, torques: Array) -> Array:
        """(12,) of (J,): a motor bears what all its joints do [Nm]."""
        borne = np.zeros(HAND.joint_count)
        np.add.at(borne, HAND.source, HAND.ratio * torques)
        return self.angles(borne)

    def joint_torques(self, torques: Array) -> Array:
        """(J,) of (12,), at the joint that the motor drives [Nm]."""
        values = np.zeros(HAND.joint_count)
        values[self._rows] = torques * self._signs
        return values


class DexHand021Firmware(HandFirmware):
    """Six boards: report once they are told to, and stand still from an error until it is cleared."""

    def __init__(self) -> None:
        super().__init__()
        self._wiring = _Wiring()
        self._targets = np.zeros((BOARDS, 2))
        self._reporting: set[int] = set()
        self._errors: dict[int, int] = {}

    def receive(self, message: can.Message) -> list[can.Message]:
        """See `HandFirmware`; only settings are answered."""
        kind, board = codec.address(message)
        motion = codec.decode_motion(message)
        if motion is not None and board not in self._errors:
            self._targets[board] = motion[1]
            target = np.clip(self._wiring.joints(self._targets.reshape(-1)), HAND.lower, HAND.upper)
            self.command = HandCommand("hold", target, sequence=self.command.sequence + 1)
        if kind != "setting":
            return []
        if codec.is_clear(message):
            self._errors.pop(board, None)
        elif codec.starts_reporting(message):
            self._reporting.add(board)
        return [codec.encode_done(message)]

    def state(self, positions: Array, torques: Array, forces: Array, clock: float) -> list[can.Message]:
        """See `HandFirmware`; the boards have no clock."""
        angles, borne = _pairs(self._wiring.angles(positions)), _pairs(self._wiring.motor_torques(torques))
        felt = dict(zip(TACTILE_BOARDS, _pairs(forces), strict=True))
        return [
            codec.encode_state(board, BoardState(angles[board], borne[board], felt.get(board)))
            for board in sorted(self._reporting)
        ]

    def inject(self, fault: str, fingers: Sequence[bool]) -> list[can.Message]:
        """See `HandFirmware`: both motors of a finger's board fail."""
        if fault == "none":
            self._errors.clear()
            return []
        if fault not in ERRORS:
            raise ValueError(f"unknown fault {fault!r}; the hand knows {', '.join(ERRORS)}")
        bits = ERRORS[fault] | ERRORS[fault] << 4
        boards = [board for board, hit in zip(TACTILE_BOARDS, fingers, strict=True) if hit]
        self._errors |= dict.fromkeys(boards, bits)
        return [codec.encode_error(board, bits) for board in boards]


class DexHand021(HandProtocol):
    """Leads the hand cycle by cycle. A cycle ends with the report of the last board and takes `STATE_PERIOD`."""

    firmware = DexHand021Firmware
    data_bitrate = 5_000_000

    def __init__(self, settings: HandSettings) -> None:
        super().__init__(settings)
        self._wiring = _Wiring()
        self._boards: dict[int, BoardState] = {}
        self._errors: dict[int, int] = {}
        self._absent: set[int] = set()
        self._cycles = 0
        self._points: SetPoints | None = None
        self._wanted: HandCommand | None = None

    def greet(self) -> list[can.Message]:
        """Switch the reports on."""
        return codec.encode_reporting(STATE_PERIOD)

    def command(self, command: HandCommand) -> list[can.Message]:
        """None at once: `follow_up` carries it out."""
        self._wanted = command
        return []

    def receive(self, message: can.Message) -> bool:
        """See `HandProtocol`."""
        said = codec.decode(message)
        if said is None:
            return False
        board, what = said
        if isinstance(what, BoardState):
            self._report(board, what)
        elif what:
            self._errors[board] = what
        else:
            self._errors.pop(board, None)
        return True

    def follow_up(self) -> list[can.Message]:
        """Targets of the next cycle. A motor that stalls on what it holds must go on pushing: that error is cleared."""
        if self.state is None or self._wanted is None:
            return []
        # Before a new command is taken: a stall on what was held until now is none on the way to positions.
        stalled = [board for board, bits in self._errors.copy().items() if self._tolerated(bits)]
        if self._points is None:
            self._points = SetPoints(self.state.positions)
        if self._points.command is not self._wanted:
            self._points.take(self._wanted, self.state.positions)
        self._points.step(self.state.torques, STATE_PERIOD)
        lead = LEAD + np.abs(self.state.torques)[HAND.source] / LEAD_STIFFNESS
        joints = self._points.stay_near(self.state.positions, lead)
        return [*map(codec.encode_clear, stalled), *codec.encode_motion(self._wiring.angles(joints))]

    @property
    def fault(self) -> DgsError | None:
        """A stall on the way to positions is HAND_BLOCKED, everything else HAND_INTERNAL."""
        errors = {board: bits for board, bits in self._errors.copy().items() if not self._tolerated(bits)}
        if not errors:
            return None
        blocked = not any(bits & ~_STALL for bits in errors.values())
        what = "; ".join(f"{name} of {', '.join(joints)}" for name, joints in _by_name(errors))
        code = ErrorCode.HAND_BLOCKED if blocked else ErrorCode.HAND_INTERNAL
        return DgsError(code, f"the hand reports {what}; the next goal clears it")

    def clear_fault(self) -> list[can.Message]:
        """See `HandProtocol`."""
        return [codec.encode_clear(board) for board in self._errors.copy()]

    @property
    def absent(self) -> str:
        """See `HandProtocol`."""
        return "; ".join(_board_name(board) for board in sorted(self._absent))

    def _tolerated(self, bits: int) -> bool:
        return not bits & ~_STALL and self._points is not None and self._points.command.mode != "position"

    def _report(self, board: int, report: BoardState) -> None:
        if board in self._boards:  # a board's report was lost
            self.incomplete += 1
            self._cycles += 1
            self._absent = set(range(BOARDS)) - self._boards.keys()
            self._boards.clear()
        self._boards[board] = report
        if len(self._boards) < BOARDS:
            return
        self._absent = set()
        boards = [self._boards[k] for k in range(BOARDS)]
        self._boards.clear()
        self._cycles += 1
        taken = self._points.command if self._points else None
        self.state = HandState(
            positions=self._wiring.joints(np.ravel([b.angles for b in boards])),
            torques=self._wiring.joint_torques(np.ravel([b.torques for b in boards])),
            mode=taken.mode if taken else "position",
            accepted=taken.sequence if taken else 0,
            clock=self._cycles * STATE_PERIOD,
            received=time.monotonic(),
            cycle=(self.state.cycle if self.state else 0) + 1,
            forces=_forces(boards),
        )


def _pairs(values: Array) -> list[Pair]:
    return [(first, second) for first, second in values.reshape(-1, 2).tolist()]


def _forces(boards: Sequence[BoardState]) -> Array | None:
    """(F, 2) of the fingertips [N]; None where no board has a sensor."""
    felt = [boards[k].forces for k in TACTILE_BOARDS]
    if not any(felt):
        return None
    return np.array([(np.nan, np.nan) if pair is None else pair for pair in felt])


def _board_name(board: int) -> str:
    first, second = (name for name, _ in MOTORS[2 * board : 2 * board + 2])
    return f"board {codec.FIRST_BOARD + board} of {first}, {second}"


def _by_name(errors: dict[int, int]) -> Iterator[tuple[str, list[str]]]:
    """Errors, and the joints that have them."""
    for name, bit in ERRORS.items():
        joints = [
            MOTORS[2 * b + m][0] for b, bits in sorted(errors.items()) for m in (0, 1) if bits >> 4 * m & bit
        ]
        if joints:
            yield name, joints

import math
import re
import struct
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.errors import ErrorCode
from dgs_hand_driver import dexhand_021_codec as codec
from dgs_hand_driver.dexhand_021 import DexHand021Firmware
from dgs_hand_driver.dexhand_021_codec import BoardState
from tests.support.environment import REPO_ROOT, run_as
from tests.support.refused import refused

boards = st.integers(0, codec.BOARDS - 1)
angles = st.floats(-3.2, 3.2)
pairs = st.tuples(angles, angles)
torques = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))
forces = st.tuples(st.floats(0.0, 50.0, width=32), st.floats(0.0, 50.0, width=32))


SENT = [
    *codec.encode_motion(np.zeros(12)),
    codec.encode_clear(0),
    codec.encode_done(codec.encode_clear(0)),
    codec.encode_state(0, BoardState((0.0, 0.0), (0.0, 0.0))),
    codec.encode_error(0, 1),
]
"""A frame of every kind."""


def frame(identifier: int, data: str, **more: bool) -> can.Message:
    return can.Message(
        arbitration_id=identifier, data=bytes.fromhex(data), is_fd=True, is_extended_id=False, **more
    )


def text(message: can.Message) -> str:
    assert message.is_fd and not message.is_extended_id
    return f"{message.arbitration_id:03X}#{bytes(message.data).hex()}"


def test_commands_are_the_makers_bytes() -> None:
    targets = np.zeros(12)
    targets[:2] = math.radians(10.0), math.radians(-20.0)
    frames = codec.encode_motion(targets)
    assert [text(f) for f in frames[:2]] == ["107#4403e80330f8", "108#440300000000"]
    assert [f.arbitration_id for f in frames] == list(range(0x107, 0x10D))
    assert text(codec.encode_clear(2)) == "009#03a4"
    assert [text(f) for f in codec.encode_reporting(0.01)][::5] == ["007#0374010101", "00C#0374010101"]


def test_reports_are_read_as_the_maker_writes_them() -> None:
    drives = struct.pack("<hhhhhhhh", 250, -7, 1200, -500, 9, -3, 4512, -150)
    tactile = struct.pack("<fIfIHII", 1.5, 1, 0.5, 2, 359, 3, 31)
    data = (drives + tactile + struct.pack("<HH", 100, 200)).ljust(64, b"\0")
    state = BoardState(
        pytest.approx((math.radians(45.12), math.radians(-1.5))),
        pytest.approx((0.25 * codec.TORQUE_PER_AMPERE, -0.5 * codec.TORQUE_PER_AMPERE)),
        (1.5, 0.5),
    )
    assert codec.decode(frame(0x187, data.hex())) == (0, state)
    bare = codec.decode(frame(0x187, data[:16].hex()))
    assert bare is not None and bare[1] == BoardState(state.angles, state.torques, None)
    turning = codec.decode(frame(0x188, data.hex()))
    assert turning is not None and turning[1].forces is None  # no fingertip hangs on the second board


def test_a_stall_as_a_hand_was_seen_to_report_it() -> None:
    assert codec.decode(frame(0x609, "ee0104" + 61 * "00")) == (2, codec.ERRORS["stall"])


@pytest.mark.parametrize(
    ("data", "said"), [("03a40001", (3, 0)), ("03a40000", None), ("03a4", None), ("03740001", None)]
)
def test_only_success_is_taken_for_cleared(data: str, said: object) -> None:
    assert codec.decode(frame(0x08A, data)) == said


@pytest.mark.parametrize(
    "foreign",
    [
        frame(0x186, 16 * "00"),  # a left hand's
        frame(0x18D, 16 * "00"),
        frame(0x187, 15 * "00"),
        frame(0x607, "ff0101"),
        frame(0x607, "ee"),
        frame(0x207, 16 * "00"),
        frame(0x187, 16 * "00", is_error_frame=True),
        can.Message(arbitration_id=0x187, data=bytes(64), is_fd=True, is_extended_id=True),
        can.Message(arbitration_id=0x187, dlc=8, is_remote_frame=True, is_extended_id=False),
    ],
)
def test_foreign_and_damaged_frames_are_ignored(foreign: can.Message) -> None:
    assert codec.decode(foreign) is None


@given(targets=st.lists(angles, min_size=12, max_size=12))
def test_targets_survive_the_bus(targets: list[float]) -> None:
    taken = dict(filter(None, map(codec.decode_motion, codec.encode_motion(targets))))
    assert np.abs(np.ravel([taken[k] for k in range(6)]) - targets).max() <= math.radians(0.00501)


def test_wild_targets_end_at_the_range() -> None:
    assert text(codec.encode_motion(np.full(12, 1e6))[0]) == "107#4403ff7fff7f"


@given(board=boards, turned=pairs, borne=torques, felt=forces)
def test_reports_survive_the_bus(board: int, turned, borne, felt) -> None:
    sent = codec.encode_state(board, BoardState(turned, borne, felt))
    assert len(sent.data) == 64
    heard = codec.decode(sent)
    assert heard is not None and heard[0] == board
    assert heard[1].angles == pytest.approx(turned, abs=math.radians(0.00501))
    assert heard[1].torques == pytest.approx(borne, abs=0.00051 * codec.TORQUE_PER_AMPERE)
    assert heard[1].forces == (felt if board in codec.TACTILE_BOARDS else None)


@given(board=boards, bits=st.integers(1, 255))
def test_errors_survive_the_bus(board: int, bits: int) -> None:
    assert codec.decode(codec.encode_error(board, bits)) == (board, bits)


@given(identifier=st.integers(0, 0x7FF), data=st.binary(max_size=64))
def test_no_frame_crashes_the_reader(identifier: int, data: bytes) -> None:
    message = can.Message(arbitration_id=identifier, data=data, is_fd=True, is_extended_id=False)
    codec.decode(message)
    codec.decode_motion(message)


def test_another_hand_cannot_speak_it() -> None:
    with refused(ErrorCode.HAND_PROTOCOL, "not those of dexhand_pro"):
        DexHand021Firmware()


def test_both_ends_in_a_process_of_that_hand() -> None:
    done = run_as("dexhand_021", Path(__file__).with_name("of_dexhand_021.py"))
    assert done.returncode == 0, done.stdout[-4000:]


def test_document_lists_the_identifiers_and_the_wiring() -> None:
    text = (REPO_ROOT / "docs" / "hand_can_protocol.md").read_text()
    bases = {int(base, 16) for base in re.findall(r"^\| `0x([0-9A-F]{3})` \|", text, re.M)}
    assert bases == {f.arbitration_id & ~0x7F for f in SENT}
    for board in (0, 1):
        first, second = (name for name, _ in codec.MOTORS[2 * board : 2 * board + 2])
        assert f"| {codec.FIRST_BOARD + board} | `{first}`, `{second}`" in text
    assert f"numbers {codec.FIRST_BOARD} to {codec.FIRST_BOARD + codec.BOARDS - 1}" in text

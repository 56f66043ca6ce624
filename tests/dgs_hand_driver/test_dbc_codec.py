import re
from importlib import resources
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from dgs_hand_driver.dbc_codec import (
    DBC_NAME,
    DbcCodec,
    FaultFrame,
    FingerFrame,
    HeartbeatFrame,
    ModeFrame,
    StatusFrame,
    expand_positions,
    expand_torques,
)
from dgs_hand_driver.hand_state import STATE_PERIOD
from tests.support.environment import REPO_ROOT
from tests.support.refused import refused

PROTOCOL = DbcCodec()
DBC = (resources.files("dgs_hand_driver") / DBC_NAME).read_text()
flags = st.lists(st.booleans(), min_size=5, max_size=5).map(tuple)
sequences = st.integers(0, 255)
modes = st.sampled_from(["position", "admittance", "hold"])
shares = st.lists(st.floats(0.0, 1.0), min_size=15, max_size=15)


def angles(share: list[float]) -> np.ndarray:
    full = HAND.lower + HAND.expand(np.array(share)) * (HAND.upper - HAND.lower)
    return full


def over_the_wire(frame: can.Message) -> can.Message:
    return can.Message(arbitration_id=frame.arbitration_id, data=bytes(frame.data), is_extended_id=False)


@given(share=shares, speed=st.floats(0.0, 3.14), active=flags, mode=modes, sequence=sequences)
def test_command_survives_the_bus(share, speed, active, mode, sequence) -> None:
    target = angles(share)
    frames = PROTOCOL.encode_command(mode, target, speed, active, sequence)
    *fingers, last = [PROTOCOL.decode(over_the_wire(frame)) for frame in frames]
    assert [f.finger for f in fingers] == list(range(5))
    assert all(isinstance(f, FingerFrame) and f.kind == "command" and f.sequence == sequence for f in fingers)
    assert np.abs(expand_positions([f.values for f in fingers]) - target).max() <= 0.51e-4
    assert isinstance(last, ModeFrame)
    assert (last.mode, last.active, last.sequence) == (mode, active, sequence)
    assert last.speed == pytest.approx(speed, abs=0.51e-3)


@given(
    share=shares,
    torque=st.lists(st.floats(-2.0, 2.0), min_size=20, max_size=20),
    mode=modes,
    accepted=sequences,
    clock=st.floats(0.0, 4e6),
    sequence=sequences,
)
def test_state_survives_the_bus(share, torque, mode, accepted, clock, sequence) -> None:
    positions, torques = angles(share), np.array(torque)
    frames = PROTOCOL.encode_state(positions, torques, mode, accepted, clock, sequence)
    decoded = [PROTOCOL.decode(over_the_wire(frame)) for frame in frames]
    rows = {kind: [f.values for f in decoded[:-1] if f.kind == kind] for kind in ("position", "torque")}
    assert np.abs(expand_positions(rows["position"]) - positions).max() <= 0.51e-4
    drive = HAND.split(expand_torques(rows["torque"]))
    assert np.abs(drive[:, :2] - HAND.split(torques)[:, :2]).max() <= 0.51e-3
    assert np.abs(drive[:, 2:].sum(1) - HAND.split(torques)[:, 2:].sum(1)).max() <= 0.51e-3
    status = decoded[-1]
    assert isinstance(status, StatusFrame)
    assert (status.mode, status.accepted, status.sequence) == (mode, accepted, sequence)
    assert status.clock == pytest.approx(clock, abs=0.51e-3)


@given(fault=st.sampled_from(PROTOCOL.faults), fingers=flags, sequence=sequences, uptime=st.floats(0.0, 4e6))
def test_fault_and_heartbeat_survive_the_bus(fault, fingers, sequence, uptime) -> None:
    assert PROTOCOL.decode(over_the_wire(PROTOCOL.encode_fault(fault, fingers, sequence))) == FaultFrame(
        fault, fingers, sequence
    )
    beat = PROTOCOL.decode(over_the_wire(PROTOCOL.encode_heartbeat(uptime, sequence)))
    assert isinstance(beat, HeartbeatFrame)
    assert beat.uptime == pytest.approx(uptime, abs=0.51e-3)


def test_a_signal_may_have_names_for_its_values(tmp_path) -> None:
    file = tmp_path / "named.dbc"
    file.write_text(DBC + '\nVAL_ 1792 Protocol 1 "first" ;\n')
    codec = DbcCodec(file)
    assert codec.decode(over_the_wire(codec.encode_heartbeat(1.0, 7))) == HeartbeatFrame(1.0, 1, 7)


@given(share=shares, which=st.integers(0, 5), byte=st.integers(0, 7), change=st.integers(1, 255))
def test_damaged_frame_is_not_believed(share, which, byte, change) -> None:
    frame = over_the_wire(PROTOCOL.encode_command("position", angles(share), 1.0, [True] * 5, 3)[which])
    frame.data[byte] ^= change
    assert PROTOCOL.decode(frame) is None


def test_frame_under_another_fingers_identifier_is_not_believed() -> None:
    thumb, index, *_ = PROTOCOL.encode_command("position", np.zeros(20), 1.0, [True] * 5, 3)
    forged = can.Message(arbitration_id=index.arbitration_id, data=bytes(thumb.data), is_extended_id=False)
    assert PROTOCOL.decode(forged) is None


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0x7AB, data=bytes(8), is_extended_id=False),
        can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=True),
        can.Message(arbitration_id=0x100, data=bytes(3), is_extended_id=False),
        can.Message(arbitration_id=0x100, dlc=8, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x100, data=bytes(8), is_error_frame=True),
    ],
)
def test_foreign_frames_are_ignored(frame: can.Message) -> None:
    assert PROTOCOL.decode(frame) is None


def test_wild_numbers_are_sent_as_the_ends_of_the_range() -> None:
    frames = PROTOCOL.encode_command("position", np.full(20, 100.0), 1.0, [True] * 5, 0)
    values = [PROTOCOL.decode(frame).values for frame in frames[:5]]
    assert np.allclose(expand_positions(values), HAND.upper, atol=0.01)
    frames = PROTOCOL.encode_state(np.full(20, -50.0), np.full(20, 99.0), "hold", 0, 0.0, 0)
    assert PROTOCOL.decode(frames[0]).values == pytest.approx((-3.2, -3.2, -3.2))
    assert PROTOCOL.decode(frames[5]).values == pytest.approx((32.0, 32.0, 32.0))


def test_unknown_fault_is_refused() -> None:
    with pytest.raises(ValueError, match="over_temperature"):
        PROTOCOL.encode_fault("tired", [False] * 5, 0)


def test_a_database_with_other_bits_works_without_touching_code(tmp_path: Path) -> None:
    other = DBC.replace("BO_ 257 ThumbCommand", "BO_ 300 ThumbCommand")
    other = other.replace(
        "SG_ Pitch : 16|16@1- (0.0001,0) [0|1.49]", "SG_ Pitch : 16|16@1- (-0.001,0) [0|1.49]"
    )
    other = re.sub(r" SG_ Crc .*\n", "", other)
    file = tmp_path / "maker.dbc"
    file.write_text(other)
    maker = DbcCodec(file)
    frame = maker.encode_command("position", np.full(20, 0.2), 1.0, [True] * 5, 9)[0]
    assert frame.arbitration_id == 300
    assert int.from_bytes(frame.data[2:4], "little", signed=True) == -200
    assert frame.data[7] == 0
    assert maker.decode(frame).values == pytest.approx((0.2, 0.2, 0.2))
    mode = maker.encode_command("position", np.full(20, 0.2), 1.0, [True] * 5, 9)[-1]
    assert maker.decode(mode) is not None
    mode.data[0] = 7
    assert maker.decode(mode) is None, "no mode that anybody knows"


def test_a_hand_that_is_slower_than_the_command_gets_the_end_of_its_range(tmp_path: Path) -> None:
    file = tmp_path / "slow.dbc"
    file.write_text(DBC.replace("[0|3.14]", "[0|0.5]"))
    slow = DbcCodec(file)
    assert slow.decode(slow.encode_command("hold", np.zeros(20), 1.0, [True] * 5, 9)[-1]).speed == 0.5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (DBC.replace("HandStatus", "Status"), "HandStatus"),
        (re.sub(r" SG_ Speed .*\n", "", DBC), "Speed"),
        (DBC.replace('VAL_ 256 Mode 0 "position"', "VAL_ 256 Mode"), "of HandMode's Mode position"),
        (re.sub(r"VAL_ 384 .*\n", "", DBC), "of HandStatus's Mode admittance, hold, position"),
        (DBC.replace('0 "none" ', ""), "of HandFault's Fault none"),
        ("this is no database", "cannot read"),
    ],
)
def test_unfit_database_is_refused_with_what_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "bad.dbc"
    file.write_text(text)
    with refused(ErrorCode.PARAMETER_INVALID, complaint):
        DbcCodec(file)


def test_missing_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DgsError, match=r"nowhere\.dbc"):
        DbcCodec(tmp_path / "nowhere.dbc")


def test_states_leave_half_of_a_slow_bus_free() -> None:
    state = PROTOCOL.encode_state(np.zeros(20), np.zeros(HAND.joint_count), "position", 0, 0.0, 0)
    worst_bits = 135  # CAN 2.0A, 8 data bytes, all possible stuff bits, and the gap to the next frame
    load = len(state) * worst_bits / STATE_PERIOD / 500_000
    assert load < 0.5


def test_document_lists_every_message_with_its_identifier() -> None:
    text = (REPO_ROOT / "docs" / "hand_can_protocol.md").read_text()
    rows = {
        name: int(number, 16) for number, name in re.findall(r"^\| 0x([0-9A-F]{3}) \| `(\w+)`", text, re.M)
    }
    wanted = {name: int(number) for number, name in re.findall(r"^BO_ (\d+) (\w+):", DBC, re.M)}
    assert rows == wanted
    assert len(wanted) == 4 + 3 * len(HAND.fingers)

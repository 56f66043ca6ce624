import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_hand_driver.dbc_codec import CLOCK_RANGE, DbcCodec
from dgs_hand_driver.dbc_protocol import DbcFirmware, DbcProtocol
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand, HandState
from tests.support.refused import refused

CODEC = DbcCodec()


def feed(host: DbcProtocol, clock: float, sequence: int, lost: int | None = None) -> HandState:
    frames = CODEC.encode_state(np.full(20, 0.2), np.zeros(20), "position", 0, clock, sequence)
    assert all(host.receive(frame) for k, frame in enumerate(frames) if k != lost)
    return host.state


@pytest.mark.parametrize("lost", range(10))
def test_cycle_with_a_lost_frame_is_dropped_and_counted(lost: int) -> None:
    host = DbcProtocol(HandSettings())
    first = feed(host, 0.0, 1)
    assert first.cycle == 1 and not host.absent
    assert feed(host, 0.1, 2, lost) is first
    assert host.absent == HAND.fingers[lost % 5]
    assert feed(host, 2.56, 1, lost) is first, "nor is it taken from long ago when the numbers come round"
    assert feed(host, 2.57, 2).cycle == 2
    assert host.incomplete == 2


@pytest.mark.parametrize("shift", range(11))
def test_frames_of_a_cycle_may_overtake_one_another(shift: int) -> None:
    host, hand = DbcProtocol(HandSettings()), DbcFirmware()
    for k in range(3):
        frames = hand.state(np.full(20, 0.1 * k), np.zeros(20), np.zeros((5, 2)), 0.01 * k)
        frames.sort(key=lambda frame: frame.arbitration_id)
        assert all(map(host.receive, frames[shift:] + frames[:shift]))
        assert host.state.cycle == k + 1 and host.state.positions == pytest.approx(0.1 * k)
    assert host.incomplete == 0


def test_frames_of_two_cycles_are_never_mixed() -> None:
    host, hand = DbcProtocol(HandSettings()), DbcFirmware()
    first, second = (hand.state(np.full(20, q), np.zeros(20), np.zeros((5, 2)), 0.0) for q in (0.1, 0.2))
    for frame in [*first[1:], second[0]]:
        host.receive(frame)
    assert host.state is None
    for frame in second[:0:-1]:
        host.receive(frame)
    assert host.state.positions == pytest.approx(0.2) and host.incomplete == 1


def test_clock_starts_at_zero_and_never_goes_back() -> None:
    host = DbcProtocol(HandSettings())
    clocks = [100.0, 100.5, 3.0, 3.25, CLOCK_RANGE - 0.25, 0.25, 0.5]
    times = [feed(host, clock, k).clock for k, clock in enumerate(clocks)]
    # Restarted after 100.5, set forward after 3.25: nothing counts; wrapped after CLOCK_RANGE: 0.5 s.
    assert times == pytest.approx([0.0, 0.5, 0.5, 0.75, 0.75, 1.25, 1.5], abs=2e-3)


FIVE = (True, False, True, True, False)
COMMAND = """
101#00000E021D044DC1 102#3908480A560C4D87 103#3A0A81128F144D0D 104#3A0ABA1AC81C4DCC 105#3A0AF32202254D5C
100#010DE20400004DC7
"""
STATE = """
181#00000E021D0401AC 182#3908480A560C01EA 183#3A0A81128F140160 184#3A0ABA1AC81C01A1 185#3A0AF32202250131
191#18FC81FC3EFA016A 192#BDFD26FE88FD011F 193#62FFCBFFD3000198 194#070170011D0401D2 195#AC021503670701C3
180#39300000014D0177
"""


def words(frames) -> list[str]:
    assert not any(frame.is_fd or frame.is_extended_id for frame in frames)
    return [f"{frame.arbitration_id:03X}#{bytes(frame.data).hex().upper()}" for frame in frames]


def test_bytes_on_the_wire() -> None:
    target = HAND.expand(HAND.reduce(np.clip(np.linspace(0.0, 1.0, 20), HAND.lower, HAND.upper)))
    host, hand = DbcProtocol(HandSettings()), DbcFirmware()
    frames = host.command(HandCommand("admittance", target, 1.25, np.array(FIVE), 77))
    assert words(frames) == COMMAND.split()
    assert host.greet() == host.follow_up() == host.clear_fault() == []
    for frame in frames:
        assert hand.receive(frame) == []
    taken = hand.command
    assert taken.mode == "admittance" and taken.sequence == 1
    for frame in frames:
        hand.receive(frame)
    assert hand.command is taken, "sent again, it is taken only once"
    frames = hand.state(target, np.linspace(-1, 1, 20), np.ones((5, 2)), 12.345)
    assert words(frames) == STATE.split()
    assert all(map(host.receive, frames))
    assert host.state.accepted == 77 and host.state.forces is None


def test_frames_of_another_driver_are_not_the_hands() -> None:
    host = DbcProtocol(HandSettings())
    assert not any(map(host.receive, host.command(HandCommand())))


def test_a_hand_that_is_told_a_wild_target_goes_to_its_limits() -> None:
    host, hand = DbcProtocol(HandSettings()), DbcFirmware()
    for frame in host.command(HandCommand("position", np.full(20, 100.0))):
        hand.receive(frame)
    assert np.array_equal(hand.command.target, HAND.upper)


def test_yaw_is_turned_where_the_settings_say() -> None:
    turned = HandSettings(
        yaw_command_signs=(-1.0, 1.0, 1.0, 1.0, 1.0), yaw_state_signs=(1.0, -1.0, 1.0, 1.0, 1.0)
    )
    host, hand = DbcProtocol(turned), DbcFirmware()
    target = np.tile([0.1, 0.0, 0.0, 0.0], 5)
    for frame in host.command(HandCommand("position", target)):
        hand.receive(frame)
    assert hand.command.target[:8:4] == pytest.approx([-0.1, 0.1])
    for frame in hand.state(target, np.zeros(20), np.zeros((5, 2)), 0.0):
        host.receive(frame)
    assert host.state.positions[:8:4] == pytest.approx([0.1, -0.1])
    assert target[0] == 0.1


def test_every_finger_has_a_sign() -> None:
    with refused(ErrorCode.PARAMETER_INVALID, "must be 5, one a finger, got 4"):
        DbcProtocol(HandSettings(yaw_state_signs=(1.0,) * 4))


def test_a_fault_lasts_while_it_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    host, hand = DbcProtocol(HandSettings()), DbcFirmware()
    assert all(len(hand.beat(0.1 * k)) == 1 for k in range(300))
    for frame in hand.inject("over_current", FIVE):
        host.receive(frame)
    assert host.fault is not None and host.fault.code == ErrorCode.HAND_INTERNAL
    assert host.fault.message == "the hand reports over_current of thumb, middle, ring"
    monkeypatch.setattr("dgs_hand_driver.dbc_protocol.FAULT_MEMORY", 0.0)
    assert host.fault is None
    monkeypatch.setattr("dgs_hand_driver.dbc_protocol.FAULT_MEMORY", 60.0)
    heartbeat, repeated = hand.beat(30.0)
    again = DbcProtocol(HandSettings())
    assert again.receive(heartbeat) and again.fault is None
    assert again.receive(repeated) and again.fault is not None

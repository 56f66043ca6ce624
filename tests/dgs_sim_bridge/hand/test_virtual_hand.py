from collections.abc import Iterator

import can
import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_hand_driver.bus import BusSettings, open_bus
from dgs_hand_driver.dbc_codec import DbcCodec, FaultFrame, Frame, HeartbeatFrame, StatusFrame
from dgs_hand_driver.dbc_protocol import DbcProtocol
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand
from dgs_sim_bridge.hand.virtual_hand import VirtualHand
from tests.support.environment import wait_until
from tests.support.refused import refused

PROTOCOL = DbcCodec()
TARGET = np.tile([0.1, 0.5, 0.3, 0.3], 5)
NOTHING_FELT = np.zeros((5, 2))
FINGERS = [True, False, True, True, False]


@pytest.fixture
def hand() -> Iterator[VirtualHand]:
    hand = VirtualHand(port=0)
    hand.start()
    yield hand
    hand.stop()


@pytest.fixture
def bus(hand: VirtualHand) -> Iterator[can.BusABC]:
    with open_bus(BusSettings(port=hand.port)) as bus:
        wait_until(lambda: hand.clients == 1)
        yield bus


def told(hand: VirtualHand, bus: can.BusABC, *command: object) -> HandCommand:
    """What the hand has understood of a first command, given as `encode_command` takes it."""
    for frame in PROTOCOL.encode_command(*command):
        bus.send(frame)
    wait_until(lambda: hand.command().sequence == 1)
    return hand.command()


def receive(bus: can.BusABC, kind: type) -> Frame:
    for _ in range(200):
        message = bus.recv(timeout=2.0)
        assert message is not None, "the bus is silent"
        frame = PROTOCOL.decode(message)
        if isinstance(frame, kind):
            return frame
    raise AssertionError(f"no {kind.__name__} among 200 frames")


def test_before_the_first_command() -> None:
    command = VirtualHand(port=0).command()
    assert command.mode == "position" and command.sequence == 0 and not command.target.any()


def test_a_protocol_without_a_firmware_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(DbcProtocol, "firmware")
    with refused(ErrorCode.HAND_PROTOCOL, "DbcProtocol of the hand dexhand_pro has no `firmware`"):
        VirtualHand(port=0)


def test_command_arrives(hand, bus) -> None:
    command = told(hand, bus, "admittance", TARGET, 1.5, FINGERS, 255)
    assert command.mode == "admittance" and command.speed == pytest.approx(1.5)
    assert np.allclose(command.target, TARGET, atol=1e-4) and command.active.tolist() == FINGERS


def test_target_stays_within_the_limits(hand, bus) -> None:
    assert np.all(told(hand, bus, "position", HAND.upper, 1.0, FINGERS, 1).target <= HAND.upper)


@pytest.mark.parametrize("lost", range(5))
def test_command_with_a_lost_frame_is_not_taken(hand, bus, lost) -> None:
    first = PROTOCOL.encode_command("position", TARGET, 1.0, FINGERS, 1)
    second = PROTOCOL.encode_command("hold", TARGET * 0.5, 1.0, FINGERS, 2)
    third = PROTOCOL.encode_command("admittance", TARGET, 1.0, FINGERS, 3)
    del second[lost]
    for frame in first + second + third:
        bus.send(frame)
    wait_until(lambda: hand.command().mode == "admittance")
    assert hand.command().sequence == 2


def test_repeated_command_is_taken_once(hand, bus) -> None:
    frames = PROTOCOL.encode_command("position", TARGET, 1.0, FINGERS, 1)
    last = PROTOCOL.encode_command("hold", TARGET, 1.0, FINGERS, 2)
    for frame in frames * 3 + last:
        bus.send(frame)
    wait_until(lambda: hand.command().mode == "hold")
    assert hand.command().sequence == 2


def test_state_goes_out_and_acknowledges(hand, bus) -> None:
    told(hand, bus, "hold", TARGET, 1.0, FINGERS, 77)
    hand.publish_state(TARGET, np.full(20, 0.2), NOTHING_FELT, 12.5)
    status = receive(bus, StatusFrame)
    assert (status.mode, status.accepted, status.clock) == ("hold", 77, 12.5)


def test_driver_puts_the_state_together_again(hand, bus) -> None:
    hand.publish_state(TARGET, np.tile([0.1, 0.2, 0.3, 0.25], 5), NOTHING_FELT, 0.0)
    driver = DbcProtocol(HandSettings(yaw_state_signs=(1.0, 1.0, -1.0, 1.0, 1.0)))
    while driver.state is None:
        message = bus.recv(timeout=2.0)
        assert message is not None, "the bus is silent"
        driver.receive(message)
    expected = TARGET.copy()
    expected[8] *= -1
    assert np.allclose(driver.state.positions, expected, atol=1e-4)
    assert driver.state.torques[4:8] == pytest.approx([0.1, 0.2, 0.55, 0.0])


def test_heart_beats_without_states(hand, bus) -> None:
    first, second = receive(bus, HeartbeatFrame), receive(bus, HeartbeatFrame)
    assert second.sequence == (first.sequence + 1) % 256 and second.uptime > first.uptime


def test_fault_is_repeated_until_it_ends(hand, bus) -> None:
    hand.inject("over_current", FINGERS)
    for _ in range(3):
        fault = receive(bus, FaultFrame)
        assert fault.fault == "over_current" and list(fault.fingers) == FINGERS
    hand.inject("none")
    assert any(receive(bus, FaultFrame).fault == "none" for _ in range(2))


def test_unknown_fault_is_refused(hand) -> None:
    with pytest.raises(ValueError, match="tired"):
        hand.inject("tired")

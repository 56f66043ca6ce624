"""The driver against a hand with simple joints: real frames on a real (loopback) bus."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from unittest.mock import Mock

import can
import numpy as np
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from dgs_hand_driver.bus import BusSettings
from dgs_hand_driver.hand import DexHand, HandSettings
from dgs_hand_driver.move_goal import MoveGoal, parse_goal
from tests.dgs_hand_driver.simulated_hand import SimulatedHand
from tests.support.environment import GUARD, free_port, wait_until
from tests.support.refused import refused

SHAPE = np.tile([0.1, 0.8, 0.5, 0.5], 5)
SETTINGS = HandSettings(silence_timeout=0.5, bus_timeout=0.6)


def goal(positions: np.ndarray, mode: int = 0, speed: float = 2.0, active: Sequence[bool] = ()) -> MoveGoal:
    return parse_goal(HAND.joints, positions, speed, mode, active)


@pytest.fixture
def simulated() -> Iterator[SimulatedHand]:
    with SimulatedHand() as simulated:
        yield simulated


@pytest.fixture
def hand(simulated: SimulatedHand) -> Iterator[DexHand]:
    with closing(DexHand(BusSettings(port=simulated.port), SETTINGS)) as hand:
        wait_until(lambda: hand.lost is None)
        yield hand


def connected(hand: DexHand) -> bool:
    try:
        hand.state()
        return True
    except DgsError as error:
        assert error.code in (ErrorCode.HAND_BUS, ErrorCode.HAND_SILENT)
        return False


def test_hand_comes_late_goes_and_comes_back(monkeypatch) -> None:
    monkeypatch.setattr("dgs_hand_driver.hand.RETRY_PERIOD", 0.05)
    port = free_port()
    with closing(DexHand(BusSettings(port=port), SETTINGS)) as hand:
        for _ in range(2):
            wait_until(lambda: "cannot open" in (hand.lost or ""))
            assert not connected(hand)
            with SimulatedHand(port=port):
                wait_until(lambda: connected(hand))
                assert hand.move(goal(SHAPE)).code == ErrorCode.SUCCESS


@pytest.mark.parametrize("error", [can.CanOperationError("unplugged"), IndexError("a garbled line")])
def test_adapter_that_fails_at_everything_is_opened_again(monkeypatch, error: Exception) -> None:
    monkeypatch.setattr("dgs_hand_driver.hand.RETRY_PERIOD", 0.01)
    broken = Mock(**{"recv.side_effect": error, "shutdown.side_effect": can.CanOperationError("unplugged")})
    opened = Mock(return_value=broken)
    monkeypatch.setattr("dgs_hand_driver.hand.open_bus", opened)
    with closing(DexHand(BusSettings())):
        wait_until(lambda: opened.call_count > 2)


def test_a_hand_whose_clock_stands_still_keeps_no_move_waiting(simulated, hand) -> None:
    simulated.time_step = 0.0
    ended = time.monotonic() + GUARD
    with refused(ErrorCode.HAND_SILENT, "clock stands still"):
        hand.move(goal(SHAPE), cancelled=lambda: "test" if time.monotonic() > ended else "")


def test_goes_to_positions(simulated, hand) -> None:
    progress: list[float] = []
    outcome = hand.move(goal(SHAPE), on_progress=lambda _, done: progress.append(done))
    assert outcome.code == ErrorCode.SUCCESS
    assert np.abs(simulated.positions - SHAPE).max() < 0.02
    assert np.abs(outcome.state.positions - SHAPE).max() < 0.02
    assert progress[-1] > 0.95 and len(progress) > 5
    assert hand.incomplete_cycles == 0


def test_contact_on_the_way_stops_the_whole_hand(simulated, hand) -> None:
    simulated.walls = {"index_joint2": 0.3}
    outcome = hand.move(goal(SHAPE, speed=1.0))
    assert outcome.code == ErrorCode.HAND_BLOCKED and outcome.fingers_in_contact == ("index",)
    assert simulated.bus_end.command().mode == "hold"
    assert simulated.positions[9] < 0.7  # the free fingers have not gone on to 0.8 either


def test_opening_out_of_contact_is_not_refused(simulated, hand) -> None:
    simulated.walls = {"index_joint2": 0.3}
    hand.move(goal(SHAPE))
    assert hand.move(goal(SHAPE * 0)).code == ErrorCode.SUCCESS


def test_grasp_squeezes_what_it_meets(simulated, hand) -> None:
    shape = np.tile([0.0, 0.4, 0.4, 0.4], 5)
    shape[0] = -0.26
    thumb_walls = {"thumb_joint1": -0.26, "thumb_joint2": 0.3, "thumb_joint3": 0.3}
    simulated.walls = {**thumb_walls, "middle_joint2": 0.3, "middle_joint3": 0.3}
    outcome = hand.move(goal(shape, mode=1))
    assert outcome.code == ErrorCode.SUCCESS
    assert outcome.fingers_in_contact == ("thumb", "middle")
    command = simulated.bus_end.command()
    assert command.mode == "admittance" and command.active.all()
    assert np.allclose(command.target, shape, atol=1e-4)
    thumb, middle = outcome.state.torques[[1, 9]]
    assert 0.3 < thumb <= HAND.effort[1] and 0.3 < middle <= HAND.effort[9]


def test_a_finger_that_stops_before_its_limit_holds_something_whatever_torque_that_takes(simulated) -> None:
    shape, beyond = np.tile([0.0, 0.4, 0.4, 0.4], 5), HAND.grasp.beyond[1]
    simulated.walls = {"index_joint2": 0.4, "ring_joint2": 0.4 + beyond - 0.03}
    for torque, fingers in ((5.0, ("index",)), (0.01, ("index", "ring"))):
        settings = replace(SETTINGS, contact_torque=(torque,) * 3)
        with closing(DexHand(BusSettings(port=simulated.port), settings)) as hand:
            wait_until(lambda hand=hand: hand.lost is None)
            assert hand.move(goal(shape, mode=1)).fingers_in_contact == fingers
            hand.move(goal(shape * 0))


def test_grasp_closes_the_fingers_that_the_goal_states_whichever_flex(simulated, hand) -> None:
    hand.move(goal(SHAPE))
    shape, stated = SHAPE.copy(), [True, False, True, False, False]
    shape[[5, 9]] += 0.2
    assert hand.move(goal(shape, mode=1, active=stated)).code == ErrorCode.SUCCESS
    command = simulated.bus_end.command()
    assert command.active.tolist() == stated
    closed = HAND.split(simulated.positions - shape)[:, 1] > 0.9 * HAND.grasp.beyond[1]
    assert closed.tolist() == stated


def test_grasp_leaves_fingers_that_need_not_flex_idle(simulated, hand) -> None:
    hand.move(goal(SHAPE))
    shape = SHAPE.copy()
    shape[[1, 5]] += 0.2
    outcome = hand.move(goal(shape, mode=1))
    command = simulated.bus_end.command()
    assert outcome.code == ErrorCode.SUCCESS and outcome.fingers_in_contact == ()
    assert command.active.tolist() == [True, True, False, False, False]
    assert np.allclose(command.target[8:], SHAPE[8:], atol=1e-4)


def test_cancel_holds_where_it_is(simulated, hand) -> None:
    simulated.slowness = 3.0
    progress = [0.0]
    outcome = hand.move(
        goal(SHAPE),
        on_progress=lambda _, done: progress.append(done),
        cancelled=lambda: "that is enough" if progress[-1] > 0.2 else "",
    )
    assert outcome.message == "that is enough; the hand holds where it is"
    assert outcome.code == ErrorCode.HAND_CANCELLED
    stopped = simulated.positions.copy()
    assert simulated.bus_end.command().mode == "hold"
    assert 0.1 < stopped[1] < 0.5
    time.sleep(10 * simulated.wall_period)
    assert np.abs(simulated.positions - stopped).max() < 0.02


def test_slow_hand_times_out_and_holds(simulated, hand) -> None:
    simulated.slowness = 12.0
    outcome = hand.move(goal(SHAPE))
    assert outcome.code == ErrorCode.HAND_TIMEOUT
    assert simulated.bus_end.command().mode == "hold"


def test_stop_holds(simulated, hand) -> None:
    hand.move(goal(SHAPE))
    hand.stop()
    command = simulated.bus_end.command()
    assert command.mode == "hold" and np.abs(command.target - SHAPE).max() < 0.02


def test_hand_that_falls_silent_during_a_move(simulated, hand) -> None:
    simulated.slowness = 5.0
    with refused(ErrorCode.HAND_SILENT, "no joint states"):
        hand.move(goal(SHAPE), on_progress=lambda *_: setattr(simulated, "silent", True))
    assert hand.lost is None  # the heart still beats


def test_hand_that_was_always_silent(simulated, hand) -> None:
    simulated.silent = True
    wait_until(lambda: time.monotonic() - hand._opened > 0.6)
    with refused(ErrorCode.HAND_SILENT):
        hand.move(goal(SHAPE))


def test_bus_that_ends_during_a_move(simulated, hand) -> None:
    simulated.slowness = 5.0
    threading.Timer(0.1, simulated.bus_end.stop).start()
    with pytest.raises(DgsError) as caught:
        hand.move(goal(SHAPE))
    assert caught.value.code in (ErrorCode.HAND_BUS, ErrorCode.HAND_SILENT)
    wait_until(lambda: hand.lost is not None)
    with refused(ErrorCode.HAND_BUS):
        hand.state()


def test_reported_fault_ends_the_move(simulated, hand) -> None:
    simulated.slowness = 5.0
    fingers = [False, True, False, False, False]
    with refused(ErrorCode.HAND_INTERNAL, "over_temperature of index"):
        hand.move(goal(SHAPE), on_progress=lambda *_: simulated.bus_end.inject("over_temperature", fingers))
    wait_until(lambda: simulated.bus_end.command().mode == "hold")
    simulated.slowness = 1.0
    simulated.bus_end.inject("none")
    wait_until(lambda: hand.fault is None)
    assert hand.move(goal(SHAPE)).code == ErrorCode.SUCCESS


def test_a_failing_listener_for_progress_ends_the_move(simulated, hand) -> None:
    simulated.slowness = 5.0
    with pytest.raises(RuntimeError, match="listener"):
        hand.move(goal(SHAPE), on_progress=Mock(side_effect=RuntimeError("listener")))
    assert simulated.bus_end.command().mode == "hold"


def test_command_is_repeated_when_frames_are_lost(simulated, hand, monkeypatch) -> None:
    lost = iter([True] * 3)
    send = hand._bus.send
    monkeypatch.setattr(hand._bus, "send", lambda frame: None if next(lost, False) else send(frame))
    assert hand.move(goal(SHAPE)).code == ErrorCode.SUCCESS
    assert simulated.bus_end.command().sequence == 1


def test_an_old_acknowledgement_does_not_pass_for_that_of_a_driver_that_was_started_again(simulated) -> None:
    for share in (0.5, 1.0):
        with closing(DexHand(BusSettings(port=simulated.port), SETTINGS)) as hand:
            wait_until(lambda hand=hand: hand.lost is None)
            lost, send = iter([True] * 6), hand._bus.send
            hand._bus.send = lambda frame, lost=lost, send=send: None if next(lost, False) else send(frame)
            assert hand.move(goal(share * SHAPE)).code == ErrorCode.SUCCESS
            assert np.abs(simulated.positions - share * SHAPE).max() < 0.02


def test_hand_that_takes_no_command(simulated, hand, monkeypatch) -> None:
    hand._first_state()
    monkeypatch.setattr(hand._bus, "send", lambda frame: None)
    with refused(ErrorCode.HAND_BUS, "not taken a command"):
        hand.move(goal(SHAPE))


def test_hand_whose_states_come_faster_than_they_are_read(simulated) -> None:
    simulated.wall_period, simulated.time_step = 0.001, 0.001
    read = threading.Event()
    with closing(DexHand(BusSettings(port=simulated.port), on_state=lambda _: read.wait(GUARD))) as hand:
        wait_until(lambda: hand._protocol.state is not None)
        sent = simulated.cycles
        wait_until(lambda: simulated.cycles > sent + 300)
        read.set()
        outcome = hand.move(goal(SHAPE))
        assert outcome.code == ErrorCode.SUCCESS and outcome.state.cycle > 300


def test_failing_listener_does_not_make_the_driver_deaf(simulated) -> None:
    calls: list[int] = []

    def listener(state) -> None:
        calls.append(state.cycle)
        raise RuntimeError("listener")

    with closing(DexHand(BusSettings(port=simulated.port), on_state=listener)) as hand:
        wait_until(lambda: len(calls) > 2)
    with pytest.raises(DgsError, match="closed"):
        hand.state()


def test_failing_protocol_is_told_and_begins_anew(simulated, monkeypatch) -> None:
    with closing(DexHand(BusSettings(port=simulated.port))) as hand:
        wait_until(lambda: connected(hand))
        monkeypatch.setattr(hand._protocol, "receive", Mock(side_effect=KeyError("Protocol")))
        wait_until(lambda: "protocol has failed: 'Protocol'" in (hand.lost or ""))
        wait_until(lambda: connected(hand))


def test_hand_that_is_silent_on_a_busy_bus_is_lost() -> None:
    bus = BusSettings(interface="virtual", channel="busy")
    with can.Bus(interface="virtual", channel="busy") as other, closing(DexHand(bus, SETTINGS)) as hand:

        def lost() -> bool:
            other.send(can.Message(arbitration_id=0x321, data=b"1", is_extended_id=False))
            return "nothing from the hand" in (hand.lost or "")

        wait_until(lost)

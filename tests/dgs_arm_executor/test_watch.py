from __future__ import annotations

import numpy as np
import pytest

import dgs_arm_executor.watch as module
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.watch import TICK, RobotWatch
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import constraints_of, declared


class Clocks:
    """Simulated and wall time that the test moves by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.simulated = self.wall = 0.0
        monkeypatch.setattr(module.time, "monotonic", lambda: self.wall)


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    return Clocks(monkeypatch)


@pytest.fixture
def watch(clocks: Clocks) -> RobotWatch:
    watch = RobotWatch(lambda: clocks.simulated, silence=0.2)
    watch.arm_state(np.arange(6.0))
    watch.hand_state(np.arange(20.0))
    return watch


def pass_time(watch: RobotWatch, clocks: Clocks, simulated: float, wall: float) -> None:
    """Let time pass in ticks of the usual period."""
    steps = max(1, round(wall / TICK))
    for _ in range(steps):
        clocks.simulated += simulated / steps
        clocks.wall += wall / steps
        watch.tick()


def code(action: object) -> ErrorCode:
    with pytest.raises(DgsError) as caught:
        action()  # type: ignore[operator]
    assert len(caught.value.message) > 15
    return caught.value.code


def test_nothing_has_come_yet(clocks: Clocks) -> None:
    fresh = RobotWatch(lambda: 0.0)
    assert code(fresh.situation) == ErrorCode.JOINT_STATES_SILENT
    assert code(fresh.check_hand) == code(fresh.hand_at_rest) == ErrorCode.HAND_UNAVAILABLE


def test_silence_counts_in_simulated_time(watch: RobotWatch, clocks: Clocks) -> None:
    pass_time(watch, clocks, 0.19, 0.6)  # a simulator at a third of real time
    np.testing.assert_array_equal(watch.situation().arm_joints, np.arange(6.0))
    pass_time(watch, clocks, 0.02, 0.08)
    assert code(watch.situation) == code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT
    watch.arm_state(np.arange(6.0))
    watch.check_motion()


def test_simulated_time_that_catches_up_in_a_burst_is_no_silence(watch: RobotWatch, clocks: Clocks) -> None:
    pass_time(watch, clocks, 0.25, 0.05)
    watch.check_motion()
    pass_time(watch, clocks, 0.25, 0.16)
    assert code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT


def test_a_robot_that_is_heard_is_not_silent_by_the_shortest_silence_that_may_be_set(clocks: Clocks) -> None:
    shortest = constraints_of(declared(ArmExecutorParameters)["joint_state_timeout"]).minimum
    assert shortest is not None
    watch = RobotWatch(lambda: clocks.simulated, silence=shortest)
    for _ in range(3):
        watch.arm_state(np.arange(6.0))
        pass_time(watch, clocks, TICK, TICK)
        watch.check_motion()


def test_silence_in_real_time_is_seen_within_a_quarter_of_a_second(watch: RobotWatch, clocks: Clocks) -> None:
    pass_time(watch, clocks, -60.0, 0.01)  # the clock was set back
    pass_time(watch, clocks, 0.24, 0.24)
    assert code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT
    watch.check_hand()
    pass_time(watch, clocks, 1.8, 1.8)
    assert code(watch.check_hand) == ErrorCode.HAND_UNAVAILABLE


def test_a_pause_of_the_program_itself_is_no_silence(watch: RobotWatch, clocks: Clocks) -> None:
    for _ in range(2):
        clocks.simulated += 3.0
        clocks.wall += 3.0
        watch.tick()
        watch.check_motion()
        watch.arm_state(np.arange(6.0))


def test_standing_simulated_time_is_silence_after_a_while(watch: RobotWatch, clocks: Clocks) -> None:
    pass_time(watch, clocks, 0.0, 4.9)
    watch.check_motion()
    pass_time(watch, clocks, 0.0, 0.2)
    assert code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT


def test_stop_is_latched_until_reset(watch: RobotWatch) -> None:
    assert watch.reset() == "there was no stop"
    watch.latch(ErrorCode.STOPPED, "motion was stopped by /stop")
    watch.latch(ErrorCode.PROTECTIVE_STOP, "later")
    assert code(watch.check_motion) == code(watch.check_motion) == ErrorCode.STOPPED
    assert "by /stop" in watch.reset()
    watch.check_motion()


def test_a_latched_stop_is_told_at_every_change() -> None:
    told: list[bool] = []
    watch = RobotWatch(lambda: 0.0, tell=told.append)
    watch.latch(ErrorCode.STOPPED, "motion was stopped by /stop")
    watch.safety_state(3)
    assert told == [False, True]
    assert code(watch.reset) == ErrorCode.PROTECTIVE_STOP and told[-1]
    watch.safety_state(1)
    watch.reset()
    watch.safety_state(3)
    assert told == [False, True, False, True]


@pytest.mark.parametrize("safety_mode", [3, 5, 6, 7, 8, 9, 12, 99])
def test_stopping_safety_modes_are_latched_and_cannot_be_reset_while_they_last(
    watch: RobotWatch, safety_mode: int
) -> None:
    watch.safety_state(safety_mode)
    assert code(watch.check_motion) == ErrorCode.PROTECTIVE_STOP
    assert code(watch.reset) == ErrorCode.PROTECTIVE_STOP
    watch.safety_state(1)
    assert code(watch.check_motion) == ErrorCode.PROTECTIVE_STOP
    watch.reset()
    watch.check_motion()
    watch.safety_state(2)  # reduced speed is no stop
    watch.check_motion()


def test_a_program_that_ends_is_latched_even_if_it_runs_again_before_anybody_looks(watch: RobotWatch) -> None:
    watch.program_state(False)
    assert code(watch.reset) == ErrorCode.PROTECTIVE_STOP
    watch.program_state(True)
    assert code(watch.check_motion) == ErrorCode.PROTECTIVE_STOP
    watch.reset()
    watch.check_motion()


def test_a_robot_that_says_that_it_runs_is_not_stopped(watch: RobotWatch) -> None:
    watch.program_state(True)
    watch.safety_state(1)
    assert watch.latched is None


def test_speed_scaling_comes_in_percent_and_a_robot_that_tells_no_number_stands(watch: RobotWatch) -> None:
    told = []
    for percent in (50.0, 120.0, -1.0, np.nan):
        watch.speed_state(percent)
        told.append(watch.speed_scaling)
    assert told == [0.5, 1.0, 0.0, 0.0]


def test_where_arm_and_hand_were_when_a_picture_was_taken(watch: RobotWatch) -> None:
    for stamp in (1.0, 2.0):
        watch.arm_state(np.full(6, stamp), stamp)
        watch.hand_state(np.full(20, 0.1 * stamp), stamp=stamp)
    then, now = watch.situation_at(1.5), watch.situation_at(9.0)
    np.testing.assert_allclose(then.arm_joints, 1.5)
    np.testing.assert_allclose(then.hand_joints, 0.15)
    np.testing.assert_allclose(now.arm_joints, 2.0)
    np.testing.assert_allclose(now.hand_joints, 0.2)


def test_a_reading_of_the_hand_has_the_torques_of_its_own_message(watch: RobotWatch) -> None:
    assert watch.situation().hand_torques is None
    watch.hand_state(np.ones(20), np.full(20, 0.1))
    now = watch.situation()
    assert now.hand_joints[0] == 1.0 and now.hand_torques is not None and now.hand_torques[3] == 0.1
    watch.hand_state(np.zeros(20))
    assert watch.situation().hand_torques is None


@pytest.mark.parametrize("set_back", [0.0, 60.0])
def test_a_hand_is_at_rest_when_new_measurements_show_no_motion(
    watch: RobotWatch, clocks: Clocks, monkeypatch: pytest.MonkeyPatch, set_back: float
) -> None:
    way = [0.5, 0.4, 0.3, 0.21, 0.205, 0.204]

    def sleep(_: float) -> None:
        clocks.simulated += 0.04 - set_back * (clocks.wall == 0.0)
        clocks.wall += 0.04
        if way and round(clocks.wall / 0.04) % 3 == 0:
            watch.hand_state(np.full(20, way.pop(0)), np.full(20, 0.2))

    monkeypatch.setattr(watch, "wait", sleep)
    rest = watch.hand_at_rest()  # the arm has been silent all the while
    assert rest.hand_joints[0] in (0.205, 0.204) and rest.hand_torques is not None


@pytest.mark.parametrize("moving", [True, False], ids=["moves", "sends nothing new"])
def test_a_hand_that_does_not_come_to_rest(
    watch: RobotWatch, clocks: Clocks, monkeypatch: pytest.MonkeyPatch, moving: bool
) -> None:
    def sleep(seconds: float) -> None:
        clocks.simulated += seconds
        clocks.wall += seconds
        if moving:
            watch.hand_state(np.full(20, clocks.wall))

    monkeypatch.setattr(watch, "wait", sleep)
    assert code(watch.hand_at_rest) == ErrorCode.HAND_UNAVAILABLE

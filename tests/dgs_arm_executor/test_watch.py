from __future__ import annotations

import numpy as np
import pytest

import dgs_arm_executor.watch as module
from dgs_arm_executor.watch import RobotWatch, WatchSettings
from dgs_description.errors import DgsError, ErrorCode


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
    watch = RobotWatch(lambda: clocks.simulated, WatchSettings(silence=0.2, wall_silence=5.0))
    watch.arm_state(np.arange(6.0))
    watch.hand_state(np.arange(20.0))
    return watch


def code(action: object) -> ErrorCode:
    with pytest.raises(DgsError) as caught:
        action()  # type: ignore[operator]
    assert len(caught.value.message) > 15
    return caught.value.code


def test_nothing_has_come_yet(clocks: Clocks) -> None:
    fresh = RobotWatch(lambda: 0.0)
    assert code(fresh.arm_joints) == ErrorCode.JOINT_STATES_SILENT
    assert code(fresh.hand_joints) == ErrorCode.HAND_UNAVAILABLE


def test_silence_counts_in_simulated_time(watch: RobotWatch, clocks: Clocks) -> None:
    clocks.simulated, clocks.wall = 0.19, 0.6  # a simulator at a third of real time
    np.testing.assert_array_equal(watch.arm_joints(), np.arange(6.0))
    clocks.simulated, clocks.wall = 0.21, 0.7
    assert code(watch.arm_joints) == code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT


def test_a_burst_of_clock_messages_is_no_silence(watch: RobotWatch, clocks: Clocks) -> None:
    clocks.simulated, clocks.wall = 0.5, 0.05
    watch.check_motion()


def test_standing_simulated_time_is_silence_after_a_while(watch: RobotWatch, clocks: Clocks) -> None:
    clocks.wall = 4.9
    watch.check_motion()
    clocks.wall = 5.1
    assert code(watch.check_motion) == ErrorCode.JOINT_STATES_SILENT


def test_stop_is_latched_until_reset(watch: RobotWatch) -> None:
    assert watch.reset() == "there was no stop"
    watch.latch(ErrorCode.STOPPED, "motion was stopped by /stop")
    watch.latch(ErrorCode.PROTECTIVE_STOP, "later")
    assert code(watch.check_motion) == code(watch.check_motion) == ErrorCode.STOPPED
    assert "by /stop" in watch.reset()
    watch.check_motion()


def test_protective_stop_is_latched_and_cannot_be_reset_while_it_lasts(watch: RobotWatch) -> None:
    watch.program_running = False
    assert code(watch.check_motion) == ErrorCode.PROTECTIVE_STOP
    assert code(watch.reset) == ErrorCode.PROTECTIVE_STOP
    watch.program_running = True
    assert code(watch.check_motion) == ErrorCode.PROTECTIVE_STOP
    watch.reset()
    watch.check_motion()

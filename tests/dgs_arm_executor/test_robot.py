"""Arm and hand at the same time, and what feedback tells on the way; controller and hand driver answer by a script."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

import dgs_arm_executor.robot as module
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.remote import RemoteGoal
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_arm_executor.watch import STANDS, RobotWatch
from dgs_description.cell import HOME_ARM
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from tests.support.refused import refused

HALF_CLOSED = np.tile([0.0, 0.5, 0.3, 0.3], 5)
GUARD = 10.0
DONE = SimpleNamespace(
    status=GoalStatus.STATUS_SUCCEEDED, result=SimpleNamespace(error_code=0, message="", error_string="")
)
ABORTED = SimpleNamespace(
    status=GoalStatus.STATUS_ABORTED,
    result=SimpleNamespace(error_code=-4, message="", error_string="aborted"),
)


class Scripted:
    """Runs a goal as the test says; `work` gets the watch, which raises what ends the goal."""

    def __init__(self, work: Callable[[Callable[[], None]], Any]) -> None:
        self.work = work
        self.cancelled = threading.Event()
        self.gone: ErrorCode | None = None

    def available(self) -> bool:
        return True

    def check(self) -> None:
        if self.gone is not None:
            raise DgsError(self.gone, "has gone")

    def cancel(self) -> None:
        self.cancelled.set()

    def run(self, goal: Any, watch: Callable[[], None], feedback: Any = None) -> Any:
        return self.work(watch)


def until(condition: Callable[[], bool], watch: Callable[[], None] = lambda: None) -> None:
    end = time.monotonic() + GUARD
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        watch()
        time.sleep(0.005)


def way() -> Trajectory:
    return time_path(SmoothPath.line(HOME_ARM, HOME_ARM + (0.2, 0, 0, 0, 0, 0)))


def made_robot(arm: Scripted, hand: Scripted, payload: Any = None, silence: float = 1e6) -> Robot:
    """Its arm is known to stand."""
    watch = RobotWatch(time.monotonic, silence)
    for stamp in (0.0, STANDS):
        watch.arm_state(HOME_ARM, stamp)
    watch.hand_state(HAND.open_hand)
    parts = cast(RemoteGoal, arm), cast(RemoteGoal, hand)
    return Robot(ArmExecutorParameters(), watch, *parts, payload, lambda fresh: ObstacleCloud())


def robot(arm: Scripted, hand: Scripted, told: list[tuple[str, bool]] | None = None) -> Robot:
    """Serves a goal."""
    made = made_robot(arm, hand)
    made.begin(
        lambda: "", lambda stage, index, share, clear: None if told is None else told.append((stage, clear))
    )
    return made


def arrive(at: Robot) -> Any:
    """News of an arm at the end of its way, and the controller's result."""
    at.watch.arm_state(way().positions[-1], 2 * STANDS)
    return DONE


def test_arm_and_hand_move_at_the_same_time() -> None:
    arm_runs, hand_runs = threading.Event(), threading.Event()

    def drive(watch: Callable[[], None]) -> Any:
        arm_runs.set()
        until(hand_runs.is_set, watch)
        return arrive(moved)

    def shape(watch: Callable[[], None]) -> Any:
        hand_runs.set()
        until(arm_runs.is_set)
        return DONE

    moved = robot(Scripted(drive), Scripted(shape))
    moved.move_both(way(), HALF_CLOSED)


@pytest.mark.parametrize("behind", [0.2, 0.02])
def test_the_result_may_be_heard_before_where_the_arm_is(behind: float) -> None:
    def drive(watch: Callable[[], None]) -> Any:
        moved.watch.arm_state(HOME_ARM + (0.2 - behind, 0, 0, 0, 0, 0), 1.5 * STANDS)
        news.start()
        return DONE

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    news = threading.Timer(0.2, arrive, [moved])
    moved.move_arm(way(), HAND.open_hand)
    np.testing.assert_array_equal(moved.situation().arm_joints, way().positions[-1])
    news.join()


def test_a_hand_that_fails_ends_the_motion_of_the_arm() -> None:
    def shape(watch: Callable[[], None]) -> Any:
        raise DgsError(ErrorCode.HAND_BLOCKED, "blocked")

    def drive(watch: Callable[[], None]) -> Any:
        until(lambda: False, watch)

    with refused(ErrorCode.HAND_BLOCKED):
        robot(Scripted(drive), Scripted(shape)).move_both(way(), HALF_CLOSED)


def test_an_arm_that_fails_ends_the_motion_of_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_STOP_NEWS", 0.05)

    def shape(watch: Callable[[], None]) -> Any:
        until(hand.cancelled.is_set)
        return DONE

    hand = Scripted(shape)
    driven = robot(Scripted(lambda watch: ABORTED), hand)
    with refused(ErrorCode.TRAJECTORY_ABORTED):
        driven.move_both(way(), HALF_CLOSED)
    assert hand.cancelled.is_set()
    with refused(ErrorCode.FORCE_LIMIT, "off its path"):
        driven.watch.force.check()


def test_an_arm_that_fails_at_once_ends_the_motion_of_the_hand_that_begins_later() -> None:
    def shape(watch: Callable[[], None]) -> Any:
        time.sleep(0.1)
        hand.cancelled.clear()  # nothing was there to cancel
        until(hand.cancelled.is_set)
        return DONE

    hand = Scripted(shape)
    moved = robot(Scripted(lambda watch: DONE), hand)
    astray = time_path(SmoothPath.line(HOME_ARM + 0.5, HOME_ARM + 0.6))
    with refused(ErrorCode.SAFETY_ENVELOPE, "nothing was sent"):
        moved.move_both(astray, HALF_CLOSED)


def test_an_arm_that_is_stopped_is_waited_for() -> None:
    stand = HOME_ARM + (0.1, 0, 0, 0, 0, 0)

    def drive(watch: Callable[[], None]) -> Any:
        moved.watch.arm_state(HOME_ARM + (0.05, 0, 0, 0, 0, 0), 2 * STANDS)
        braked.start()
        raise DgsError(ErrorCode.FORCE_LIMIT, "met something")

    def brake() -> None:
        for stamp in (3 * STANDS, 4 * STANDS):
            moved.watch.arm_state(stand, stamp)

    braked = threading.Timer(0.2, brake)
    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    with refused(ErrorCode.FORCE_LIMIT):
        moved.move_arm(way(), HAND.open_hand)
    np.testing.assert_array_equal(moved.situation().arm_joints, stand)
    braked.join()


def test_feedback_says_from_when_on_the_robot_is_out_of_view() -> None:
    told: list[tuple[str, bool]] = []
    moved = robot(Scripted(lambda watch: arrive(moved)), Scripted(lambda watch: DONE), told)
    moved.move_arm(way(), HAND.open_hand)
    assert not any(clear for _, clear in told)
    moved.watch.arm_state(HOME_ARM, 3 * STANDS)

    def drive(watch: Callable[[], None]) -> Any:
        begun = time.monotonic()
        until(lambda: time.monotonic() - begun > 0.3, watch)
        assert not moved.out_of_view, "it has not even moved yet"
        moved.watch.arm_state(HOME_ARM + (0.01, 0, 0, 0, 0, 0), 3.1 * STANDS)
        watch()
        assert not moved.out_of_view, "not yet"
        until(lambda: moved.out_of_view, watch)
        return arrive(moved)

    moved.arm = cast(RemoteGoal, Scripted(drive))
    moved.move_arm(way(), HAND.open_hand, clear_from=0.1)
    assert told[-1][1]
    moved.enter("release")
    assert told[-1] == ("release", True), "it stays so until the goal's end"
    moved.candidate = 3
    for stamp in (4, 5):
        moved.watch.arm_state(HOME_ARM, stamp * STANDS)
    moved.begin(lambda: "", lambda stage, index, share, clear: told.append((f"{stage} {index}", clear)))
    moved.enter("planning")
    assert told[-1] == ("planning -1", False)
    moved.arm = cast(RemoteGoal, Scripted(lambda watch: arrive(moved)))
    moved.move_arm(way(), HAND.open_hand, clear_from=0.1)
    assert told[-1][1], "at its end at the latest"


def test_a_goal_begins_when_the_arm_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    made = made_robot(Scripted(lambda watch: DONE), Scripted(lambda watch: DONE))
    made.watch.arm_state(HOME_ARM + 0.1, 2 * STANDS)

    def at_rest() -> None:
        for stamp in (3 * STANDS, 4 * STANDS):
            made.watch.arm_state(HOME_ARM + 0.3, stamp)

    timer = threading.Timer(0.1, at_rest)
    timer.start()
    made.begin(lambda: "", lambda stage, index, share, clear: None)
    np.testing.assert_allclose(made.situation().arm_joints, HOME_ARM + 0.3)
    timer.join()

    monkeypatch.setattr(module, "_READY_TIMEOUT", 0.1)
    made.watch.arm_state(HOME_ARM, 5 * STANDS)
    with refused(ErrorCode.SAFETY_ENVELOPE, "not at rest"):
        made.begin(lambda: "", lambda stage, index, share, clear: None)


def test_a_stop_that_is_over_before_anybody_looks_ends_the_goal() -> None:
    moved = robot(Scripted(lambda watch: DONE), Scripted(lambda watch: watch() or DONE))
    moved.watch.latch(ErrorCode.STOPPED, "motion was stopped by /stop")
    moved.watch.reset()
    with refused(ErrorCode.STOPPED):
        moved.enter("transfer")
    with refused(ErrorCode.STOPPED):
        moved.open_hand()
    moved.begin(lambda: "", lambda stage, index, share, clear: None)
    moved.enter("transfer")  # it is no matter of the next goal


def test_a_clock_that_is_set_forward_ends_no_motion() -> None:
    def drive(watch: Callable[[], None]) -> Any:
        watch()
        moved.watch.now = lambda: time.monotonic() + 3600.0
        for _ in range(3):
            watch()
        return arrive(moved)

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    moved.move_arm(way(), HAND.open_hand)


def test_a_motion_has_its_time_though_the_clock_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_TIMEOUT_FACTOR", 0.0)
    monkeypatch.setattr(module, "_TIMEOUT_EXTRA", 0.2)

    def drive(watch: Callable[[], None]) -> Any:
        watch()
        moved.watch.now = lambda: time.monotonic() - 3600.0
        until(lambda: False, watch)

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    with refused(ErrorCode.TRAJECTORY_ABORTED, "has not ended"):
        moved.move_arm(way(), HAND.open_hand)


def test_a_motion_that_the_robot_slows_down_has_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_TIMEOUT_FACTOR", 0.0)
    monkeypatch.setattr(module, "_TIMEOUT_EXTRA", 0.1)

    def drive(watch: Callable[[], None]) -> Any:
        moved.watch.speed_state(10.0)
        begun = time.monotonic()
        until(lambda: time.monotonic() - begun > 0.3, watch)
        return arrive(moved)

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    moved.move_arm(way(), HAND.open_hand)


@pytest.mark.parametrize("gone", [ErrorCode.CONTROLLER_UNAVAILABLE, ErrorCode.HAND_UNAVAILABLE])
def test_a_server_that_goes_ends_the_motion_of_the_other_one(gone: ErrorCode) -> None:
    def work(watch: Callable[[], None]) -> Any:
        other.gone = gone
        until(lambda: False, watch)

    arm, hand = Scripted(work), Scripted(work)
    moved = robot(arm, hand)
    other = hand if gone is ErrorCode.HAND_UNAVAILABLE else arm
    with refused(gone):
        moved.move_arm(way(), HAND.open_hand) if other is hand else moved.move_hand(HALF_CLOSED)


@pytest.mark.parametrize(
    ("error_code", "moves", "code"),
    [
        (-1, False, ErrorCode.TRAJECTORY_REJECTED),
        (-2, False, ErrorCode.TRAJECTORY_REJECTED),
        (-1, True, ErrorCode.TRAJECTORY_ABORTED),
        (-5, False, ErrorCode.TRAJECTORY_ABORTED),
    ],
)
def test_a_goal_that_is_found_invalid_before_the_arm_moves_was_rejected(
    error_code: int, moves: bool, code: ErrorCode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_STOP_NEWS", 0.05)

    def drive(watch: Callable[[], None]) -> Any:
        moved.watch.arm_state(HOME_ARM + 0.01 * moves, 2 * STANDS)
        result = SimpleNamespace(error_code=error_code, error_string="invalid")
        return SimpleNamespace(status=GoalStatus.STATUS_ABORTED, result=result)

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    with refused(code, f"ended the motion .{error_code}.: invalid"):
        moved.move_arm(way(), HAND.open_hand)


def test_an_abort_is_explained_by_the_stop_that_is_told_a_moment_later() -> None:
    def drive(watch: Callable[[], None]) -> Any:
        threading.Timer(0.1, moved.watch.safety_state, (3,)).start()
        return ABORTED

    moved = robot(Scripted(drive), Scripted(lambda watch: DONE))
    with refused(ErrorCode.PROTECTIVE_STOP):
        moved.move_arm(way(), HAND.open_hand)


def hand_result(status: int, code: ErrorCode) -> Any:
    return SimpleNamespace(status=status, result=SimpleNamespace(error_code=int(code), message="the hand's"))


def test_why_the_hand_does_not_come_to_its_shape() -> None:
    results = iter(
        [
            hand_result(GoalStatus.STATUS_UNKNOWN, ErrorCode.SUCCESS),
            hand_result(GoalStatus.STATUS_ABORTED, ErrorCode.HAND_BLOCKED),
            hand_result(GoalStatus.STATUS_CANCELED, ErrorCode.HAND_CANCELLED),
        ]
    )

    def shape(watch: Callable[[], None]) -> Any:
        if (result := next(results)).status == GoalStatus.STATUS_CANCELED:
            moved.watch.latch(ErrorCode.STOPPED, "stopped, which has ended the hand's goal")
        return result

    moved = robot(Scripted(lambda watch: DONE), Scripted(shape))
    for code, words in (
        (ErrorCode.HAND_UNAVAILABLE, "it was restarted"),
        (ErrorCode.HAND_BLOCKED, "the hand's"),
        (ErrorCode.STOPPED, "stopped"),
    ):
        with refused(code, words):
            moved.move_hand(HALF_CLOSED)


def test_a_hand_that_falls_silent_while_it_opens_is_not_waited_for() -> None:
    def shape(watch: Callable[[], None]) -> Any:
        until(lambda: moved.watch.tick() or False, watch)

    moved = made_robot(Scripted(lambda watch: DONE), Scripted(shape), silence=0.01)
    moved.begin(lambda: "", lambda stage, index, share, clear: None)
    with refused(ErrorCode.HAND_UNAVAILABLE, "has been silent"):
        moved.open_hand()


def test_a_hand_that_falls_silent_ends_the_motion_of_the_arm() -> None:
    def hear_the_arm() -> bool:
        moved.watch.tick()
        moved.watch.arm_state(HOME_ARM, 2 * STANDS)
        return False

    def drive(watch: Callable[[], None]) -> Any:
        until(hear_the_arm, watch)

    moved = made_robot(Scripted(drive), Scripted(lambda watch: DONE), silence=0.02)
    moved.begin(lambda: "", lambda stage, index, share, clear: None)
    with refused(ErrorCode.HAND_UNAVAILABLE, "has been silent"):
        moved.move_arm(way(), HAND.open_hand)


def test_a_robot_that_refuses_its_payload_is_not_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def answer(client: Any, request: Any, code: ErrorCode) -> Any:
        asked.append(request.mass)
        return SimpleNamespace(success=len(asked) == 1)

    monkeypatch.setattr(module, "call_service", answer)
    client = SimpleNamespace(service_is_ready=lambda: True)
    loaded = made_robot(Scripted(lambda watch: DONE), Scripted(lambda watch: DONE), client)
    loaded.set_payload(holding=False)
    with refused(ErrorCode.PAYLOAD_REFUSED, "a payload of 1.71 kg"):
        loaded.set_payload(holding=True)
    assert asked == pytest.approx([1.507, 1.707], abs=1e-3)

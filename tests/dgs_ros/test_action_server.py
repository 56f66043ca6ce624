"""An action's answers that the middleware gives up are sent again, and reach the client; ended goals are forgotten."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable

import pytest
from action_msgs.msg import GoalStatus
from dgs_interfaces.action import GoHome
from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle, _rclpy
from rclpy.task import Future

import dgs_ros.action_server
from dgs_ros.action_server import ANSWERS, CountingActionServer, patient
from tests.support.environment import wait_until
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

LOST = "failed to send response (timeout): client will not receive response"


def lossy(name: str, tries: Counter[str]) -> Callable[..., None]:
    """A compiled method that gives its first two answers up, as rclpy's does."""
    send = getattr(_rclpy.ActionServer, name)

    def try_to_send(*arguments: object) -> None:
        tries[name] += 1
        if tries[name] <= 2:
            warnings.warn(LOST, RuntimeWarning, stacklevel=2)
            pytest.fail("a warning is an error here")
        send(*arguments)

    return try_to_send


def test_all_answers_are_sent_until_they_arrive(
    ros_client: RosClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries: Counter[str] = Counter()
    handle = type("Lossy", (_rclpy.ActionServer,), {name: lossy(name, tries) for name in ANSWERS})
    monkeypatch.setattr(_rclpy, "ActionServer", patient(handle))

    cancelled: Future[None] = Future()

    async def execute(goal: ServerGoalHandle) -> GoHome.Result:
        await cancelled
        goal.canceled()
        return GoHome.Result(message="cancelled")

    def cancel(goal: ServerGoalHandle) -> CancelResponse:
        cancelled.set_result(None)
        return CancelResponse.ACCEPT

    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="failed to send response")
        server = CountingActionServer(ros_client.node, GoHome, "/go", execute, cancel_callback=cancel)
        goal = ros_client.send(GoHome, "/go", GoHome.Goal())
        assert goal.accepted
        answer = ros_client.wait(goal.cancel_goal_async())
        assert [info.goal_id for info in answer.goals_canceling] == [goal.goal_id]
        assert ros_client.wait(goal.get_result_async()).result.message == "cancelled"
    assert tries == dict.fromkeys(ANSWERS, 3)
    server.destroy()


def test_an_ended_goal_is_forgotten(ros_client: RosClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dgs_ros.action_server, "RESULT_KEPT", 3.0)

    def execute(goal: ServerGoalHandle) -> GoHome.Result:
        goal.succeed()
        return GoHome.Result(message="home")

    server = CountingActionServer(ros_client.node, GoHome, "/go", execute)
    goal = ros_client.send(GoHome, "/go", GoHome.Goal())
    assert ros_client.wait(goal.get_result_async()).result.message == "home"
    wait_until(lambda: ros_client.wait(goal.get_result_async()).status == GoalStatus.STATUS_UNKNOWN)
    server.destroy()

"""A goal of the arm whose server is not there, or never answers."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest
from action_msgs.msg import GoalStatus
from dgs_interfaces.action import ExecuteGrasp, GoHome
from rclpy.task import Future

from dgs_bringup.arm_goal import ArmGoal
from dgs_description.errors import ErrorCode
from dgs_ros.action_client import SafeActionClient
from tests.support.environment import GUARD
from tests.support.refused import refused
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


def test_a_goal_that_nobody_hears_is_over_at_once(ros_client: RosClient) -> None:
    client = SafeActionClient(ros_client.node, GoHome, "/go_home")
    begun = time.monotonic()
    goal = ArmGoal(client, "/go_home", GoHome.Goal(), lambda *_: None)
    assert goal.done()
    with refused(ErrorCode.TASK_ARM_UNAVAILABLE, "is the arm executor alive"):
        goal.result(lambda: False, GUARD, GUARD)
    assert time.monotonic() - begun < 2.0


def test_the_time_of_a_goal_counts_from_when_it_was_sent() -> None:
    handle = SimpleNamespace(accepted=True, get_result_async=Future, cancel_goal_async=Future)
    sent: Future = Future()
    client: Any = SimpleNamespace(
        watch_server=lambda: SimpleNamespace(lost=lambda: False),
        server_is_ready=lambda: True,
        send_goal_async=lambda *_, **__: sent,
        cancel_when_accepted=lambda _: None,
    )
    goal = ArmGoal(client, "/execute_grasp", None, lambda *_: None)
    sent.set_result(handle)
    time.sleep(0.5)  # the task looks ahead meanwhile
    begun = time.monotonic()
    with refused(ErrorCode.TASK_ARM_FAILED, "gave no result within"):
        goal.result(lambda: False, answer_timeout=0.1, timeout=0.5)
    assert time.monotonic() - begun < 0.4


def test_a_goal_that_was_cancelled_for_its_time_says_so() -> None:
    result: Future = Future()
    handle = SimpleNamespace(accepted=True, get_result_async=lambda: result)
    sent: Future = Future()

    def cancel(_: Future) -> None:
        answer = ExecuteGrasp.Result(error_code=217, message="transfer: cancelled on request")
        result.set_result(SimpleNamespace(status=GoalStatus.STATUS_CANCELED, result=answer))

    client: Any = SimpleNamespace(
        watch_server=lambda: SimpleNamespace(lost=lambda: False),
        server_is_ready=lambda: True,
        send_goal_async=lambda *_, **__: sent,
        cancel_when_accepted=cancel,
    )
    goal = ArmGoal(client, "/execute_grasp", None, lambda *_: None)
    sent.set_result(handle)
    said = goal.result(lambda: False, answer_timeout=0.1, timeout=0.1)
    assert (said.error_code, said.message) == (217, "not done after 0.1 s: transfer: cancelled on request")

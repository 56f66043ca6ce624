"""Feedback that was sent before the result is heard, also by a client that was held up meanwhile."""

from __future__ import annotations

import threading
import time

import pytest
from dgs_interfaces.action import GoHome
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dgs_ros.action_client import ENDED, SafeActionClient
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

STAGES = [f"stage {k}" for k in range(20)]


def test_what_was_told_before_the_result_is_heard_by_a_client_that_was_held_up(ros_client: RosClient) -> None:
    told = threading.Event()

    def execute(goal: ServerGoalHandle) -> GoHome.Result:
        for stage in STAGES:
            goal.publish_feedback(GoHome.Feedback(stage=stage))
            time.sleep(0.005)
        goal.succeed()
        told.set()
        return GoHome.Result(message="home")

    node = Node("held_up", context=ros_client.node.context)
    spinner = SingleThreadedExecutor(context=ros_client.node.context)
    spinner.add_node(node)
    client = SafeActionClient(node, GoHome, "/go")
    server = ActionServer(ros_client.node, GoHome, "/go", execute)
    assert client.wait_for_server(GUARD)
    for _ in range(ENDED + 2):
        heard: list[str] = []
        told.clear()
        sent = client.send_goal_async(
            GoHome.Goal(), feedback_callback=lambda message, heard=heard: heard.append(message.feedback.stage)
        )
        spinner.spin_until_future_complete(sent, GUARD)
        result = sent.result().get_result_async()
        assert told.wait(GUARD)
        time.sleep(0.3)  # the result waits beside the feedback
        spinner.spin_until_future_complete(result, GUARD)
        end = time.monotonic() + GUARD
        while heard != STAGES and time.monotonic() < end:
            spinner.spin_once(0.1)
        assert heard == STAGES
    assert len(client._feedback_callbacks) == ENDED, "older ones are forgotten"
    server.destroy()
    spinner.shutdown()
    node.destroy_node()

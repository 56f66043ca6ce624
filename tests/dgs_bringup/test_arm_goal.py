"""A goal of the arm whose server is not there."""

from __future__ import annotations

import time

import pytest
from dgs_interfaces.action import GoHome

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

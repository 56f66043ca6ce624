"""The base node as a process of its own: parameters and diagnostics."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from dgs_bringup.ros_session import wait_until
from tests.dgs_ros.conftest import Node
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


def test_diagnostics_carry_the_report_once_a_second(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    node = start("rate:=12.5", "corner:=[1.0, 2.0, 3.0]", "work:=thread")
    node.wait_for("ready")
    first, second = ros_client.collect(DiagnosticArray, "/diagnostics", count=2)
    assert second.header.stamp.sec >= first.header.stamp.sec > 0
    (status,) = first.status
    assert (status.name, status.hardware_id, status.message) == ("work_node", "work_node", "working")
    assert status.level == b"\x01"
    assert {value.key: value.value for value in status.values} == {
        "work": "thread",
        "rate": "12.5",
        "corner": "(1.0, 2.0, 3.0)",
    }


def test_diagnostics_go_on_while_simulated_time_stands_still(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    start("use_sim_time:=true").wait_for("ready")
    clock = ros_client.node.create_publisher(Clock, "/clock", 1)
    end = time.monotonic() + GUARD
    while time.monotonic() < end:
        clock.publish(Clock(clock=Time(sec=42)))
        (array,) = ros_client.collect(DiagnosticArray, "/diagnostics")
        if array.header.stamp.sec == 42:
            return
    pytest.fail("the node did not take the simulated time")


def test_a_broken_callback_is_reported_and_the_node_serves_on(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    seen: list[DiagnosticStatus] = []

    def keep(array: DiagnosticArray) -> None:
        seen.extend(status for status in array.status if status.name == "work_node: callbacks")

    ros_client.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    node = start("work:=raise")
    assert wait_until(lambda: seen and seen[-1].level == b"\x00", GUARD), "one event is over after a while"
    assert seen[0].level == b"\x02" and "a callback broke" in seen[0].message
    assert "the last was: " in seen[-1].message
    assert node.end(signal.SIGINT) == 0


def test_a_service_that_breaks_answers(start: Callable[..., Node], ros_client: RosClient) -> None:
    start().wait_for("ready")
    for _ in range(2):
        answer = ros_client.call(Trigger, "/work_node/break", Trigger.Request())
        assert not answer.success and "unexpected RuntimeError" in answer.message


def test_parameters_are_described_and_cannot_be_changed(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    start("names:=[]").wait_for("ready")
    request = DescribeParameters.Request(names=["rate", "work", "names"])
    rate, work, names = ros_client.call(
        DescribeParameters, "/work_node/describe_parameters", request
    ).descriptors
    assert rate.description == "Rate [Hz]."
    assert (rate.floating_point_range[0].from_value, rate.floating_point_range[0].to_value) == (1.0, 30.0)
    assert work.additional_constraints.startswith("one of 'none'")
    assert rate.read_only and work.read_only and names.read_only
    assert names.type == ParameterType.PARAMETER_STRING_ARRAY and names.description == "Names."
    values = ros_client.call(
        GetParameters, "/work_node/get_parameters", GetParameters.Request(names=["names"])
    ).values
    assert values == [ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY)]
    change = SetParameters.Request(parameters=[Parameter("rate", value=20.0).to_parameter_msg()])
    (result,) = ros_client.call(SetParameters, "/work_node/set_parameters", change).results
    assert not result.successful
    change = SetParameters.Request(parameters=[Parameter("use_sim_time", value=True).to_parameter_msg()])
    (result,) = ros_client.call(SetParameters, "/work_node/set_parameters", change).results
    assert not result.successful and "fixed when the node starts" in result.reason

"""The base node as a process of its own: parameters, exit codes, signals, diagnostics."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from dgs_ros.diagnostics import EVENT_LASTS
from tests.support.environment import ros_environment
from tests.support.ros_client import RosClient

pytestmark = [pytest.mark.integration, pytest.mark.timeout(60)]
SCRIPT = Path(__file__).with_name("node_under_test.py")
START_TIME = 10.0
END_TIME = 5.0


class Node:
    """The node's process; its output goes to a file."""

    def __init__(self, arguments: list[str], log_file: Path, domain_id: int):
        self.log_file = log_file
        command = [sys.executable, str(SCRIPT), "--ros-args"]
        for argument in arguments:
            command += ["-p", argument]
        path = os.pathsep.join(p for p in sys.path if p)
        environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain_id), "PYTHONPATH": path}
        with log_file.open("wb") as log:
            self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)

    def log(self) -> str:
        return self.log_file.read_text()

    def wait_for(self, pattern: str) -> None:
        end = time.monotonic() + START_TIME
        while not re.search(pattern, self.log()):
            assert self.process.poll() is None, f"ended with {self.process.poll()}\n{self.log()}"
            assert time.monotonic() < end, f"no {pattern!r} within {START_TIME} s\n{self.log()}"
            time.sleep(0.02)

    def end(self, number: signal.Signals) -> tuple[int, float]:
        """Exit code and seconds after a signal."""
        start = time.monotonic()
        self.process.send_signal(number)
        return self.process.wait(END_TIME), time.monotonic() - start


@pytest.fixture
def start(tmp_path: Path, ros_domain_id: int) -> Iterator[Callable[..., Node]]:
    nodes: list[Node] = []

    def start_node(*arguments: str) -> Node:
        nodes.append(Node(list(arguments), tmp_path / f"node{len(nodes)}.log", ros_domain_id))
        return nodes[-1]

    yield start_node
    for node in nodes:
        node.process.kill()
        node.process.wait()


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("rat:=5.0", "unknown parameter 'rat'; there are: corner, names, rate, work"),
        ("rate:=31.0", "parameter 'rate' must be 1 to 30, got 31.0"),
        ("executor_threads:=1", "parameter 'executor_threads' must be 2 to 64"),
        ("work:=half_built", "no camera"),
    ],
)
def test_a_refusal_to_start_is_one_sentence_and_exit_code_2(
    start: Callable[..., Node], argument: str, words: str
) -> None:
    node = start(argument)
    assert node.process.wait(START_TIME) == 2, node.log()
    assert words in node.log()
    assert "Traceback" not in node.log()


def test_a_broken_node_ends_with_1_and_a_traceback(start: Callable[..., Node]) -> None:
    node = start("work:=break")
    assert node.process.wait(START_TIME) == 1
    assert "RuntimeError: something broke" in node.log()


def test_a_context_shut_down_from_inside_is_no_clean_end(start: Callable[..., Node]) -> None:
    node = start("work:=context")
    assert node.process.wait(START_TIME) == 1, node.log()


@pytest.mark.parametrize(
    ("number", "work"),
    [
        (signal.SIGINT, "none"),
        (signal.SIGINT, "thread"),
        (signal.SIGINT, "callbacks"),
        (signal.SIGINT, "stubborn"),
        (signal.SIGTERM, "callbacks"),
    ],
)
def test_a_signal_ends_the_node_with_0_whatever_it_does(
    start: Callable[..., Node], number: signal.Signals, work: str
) -> None:
    node = start(f"work:={work}")
    node.wait_for(r"ready" if work == "none" else r"busy")
    node.wait_for(r"ready")
    code, took = node.end(number)
    assert code == 0, node.log()
    assert "closing" in node.log()
    assert "Traceback" not in node.log()
    if work in ("none", "thread"):
        assert took < 2.5, "a node that listens must not need the watchdog"


def test_diagnostics_carry_the_report_once_a_second(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    node = start("rate:=12.5", "corner:=[1.0, 2.0, 3.0]", "work:=thread")
    node.wait_for("ready")
    first, second = ros_client.collect(DiagnosticArray, "/diagnostics", count=2, timeout=10.0)
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
    end = time.monotonic() + 10
    while time.monotonic() < end:
        clock.publish(Clock(clock=Time(sec=42)))
        (array,) = ros_client.collect(DiagnosticArray, "/diagnostics", timeout=10.0)
        if array.header.stamp.sec == 42:
            return
    pytest.fail("the node did not take the simulated time")


def test_a_broken_callback_is_reported_and_the_node_serves_on(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    node = start("work:=raise")
    node.wait_for("a callback broke")
    end = time.monotonic() + 10
    while time.monotonic() < end:
        (array,) = ros_client.collect(DiagnosticArray, "/diagnostics", timeout=10.0)
        found = {status.name: status for status in array.status}
        if "work_node: callbacks" in found:
            break
    assert found["work_node: callbacks"].level == b"\x02"
    assert "a callback broke" in found["work_node: callbacks"].message
    while time.monotonic() < end + EVENT_LASTS and found["work_node: callbacks"].level != b"\x00":
        (array,) = ros_client.collect(DiagnosticArray, "/diagnostics", timeout=10.0)
        found = {status.name: status for status in array.status}
    assert found["work_node: callbacks"].level == b"\x00", "one event is over after a while"
    assert "the last was: " in found["work_node: callbacks"].message
    assert node.end(signal.SIGINT)[0] == 0


def test_parameters_are_described_and_cannot_be_changed(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    start().wait_for("ready")
    request = DescribeParameters.Request(names=["rate", "work", "names"])
    rate, work, names = ros_client.call(
        DescribeParameters, "/work_node/describe_parameters", request
    ).descriptors
    assert rate.description == "Rate [Hz]."
    assert (rate.floating_point_range[0].from_value, rate.floating_point_range[0].to_value) == (1.0, 30.0)
    assert work.additional_constraints.startswith("one of 'none'")
    assert rate.read_only and work.read_only and names.read_only
    change = SetParameters.Request(parameters=[Parameter("rate", value=20.0).to_parameter_msg()])
    (result,) = ros_client.call(SetParameters, "/work_node/set_parameters", change).results
    assert not result.successful

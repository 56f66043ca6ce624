"""Nodes as processes: exit codes, and what signals do."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from rcl_interfaces.msg import Log
from rclpy.qos import DurabilityPolicy, QoSProfile

from dgs_ros.run import timer_wakes
from tests.dgs_ros.conftest import Node
from tests.support.environment import GUARD, wait_until
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("rat:=5.0", "unknown parameter 'rat'; there are: corner, names, rate, work"),
        ("rate:=31.0", "parameter 'rate' must be 1 to 30, got 31.0"),
        ("use_sim_time:=5", "parameter 'use_sim_time' to '5' of type 'INTEGER', expecting type 'BOOL'"),
        ("rate", "Couldn't parse parameter override rule: '-p rate' (code 12)"),
        ("rate:=", "Couldn't parse parameter override rule: '-p rate:=' (code 12)"),
        ("--params-file absent.yaml", "absent.yaml"),
        ("--speed", "ROS refuses: ['--speed']"),
        ("work:=half_built", "no camera"),
    ],
)
def test_a_refusal_to_start_is_one_sentence_and_exit_code_2(
    start: Callable[..., Node], argument: str, words: str
) -> None:
    node = start(argument)
    assert node.process.wait(GUARD) == 2, node.log()
    assert words in node.log()
    assert "Traceback" not in node.log()


def test_a_broken_node_ends_with_1_and_a_traceback(start: Callable[..., Node]) -> None:
    node = start("work:=break")
    assert node.process.wait(GUARD) == 1
    assert "RuntimeError: something broke" in node.log()


def test_a_context_shut_down_from_inside_is_no_clean_end(start: Callable[..., Node]) -> None:
    node = start("work:=context")
    assert node.process.wait(GUARD) == 1, node.log()


@pytest.mark.parametrize(
    ("number", "work"),
    [
        (signal.SIGINT, "none"),
        (signal.SIGINT, "thread"),
        (signal.SIGINT, "callbacks"),
        (signal.SIGINT, "stubborn"),
        (signal.SIGTERM, "callbacks"),
        (signal.SIGHUP, "none"),
    ],
)
def test_a_signal_ends_the_node_with_0_whatever_it_does(
    start: Callable[..., Node], number: signal.Signals, work: str
) -> None:
    node = start(f"work:={work}")
    node.wait_for(r"ready" if work == "none" else r"busy")
    node.wait_for(r"ready")
    assert node.end(number) == 0, node.log()
    assert "closing" in node.log()
    assert "Traceback" not in node.log()
    if work in ("none", "thread"):
        assert "destroyed" in node.log(), "a node that listens must not need the watchdog"


def test_a_node_that_a_library_holds_ends_with_1_and_says_where(start: Callable[..., Node]) -> None:
    node = start("work:=stuck")
    node.wait_for(r"ready")
    assert node.end(signal.SIGINT) == 1, node.log()
    assert "in hold_the_lock" in node.log()


def test_a_node_that_a_library_holds_ends_unasked_and_says_where(start: Callable[..., Node]) -> None:
    node = start("work:=held")
    assert node.process.wait(GUARD) == 1, node.log()
    assert "in hold_the_lock" in node.log()


def test_a_node_whose_middleware_stands_still_ends_unasked_and_says_so(start: Callable[..., Node]) -> None:
    node = start("work:=locked_up")
    assert node.process.wait(GUARD) == 1, node.log()
    assert "it has locked itself up" in node.log() and "Thread" in node.log()


def test_the_timers_of_a_healthy_middleware_are_seen_to_go_on(start: Callable[..., Node]) -> None:
    node = start("work:=none")
    node.wait_for(r"ready")
    before = timer_wakes(node.process.pid)
    assert before > 0
    wait_until(lambda: timer_wakes(node.process.pid) > before + 5)


def test_threads_do_not_each_keep_the_largest_thing_they_worked_on(start: Callable[..., Node]) -> None:
    node = start("work:=memory")
    node.wait_for(r"kept \d+ MiB")
    kept = re.search(r"kept (\d+) MiB", node.log())
    assert kept and int(kept[1]) < 130, node.log()


def segments_of(node: Node) -> set[Path]:
    maps = Path(f"/proc/{node.process.pid}/maps").read_text()
    return {Path(name) for name in re.findall(r"/dev/shm/fastrtps_[0-9a-f]{16}", maps)}


def test_what_a_killed_node_leaves_is_removed_by_the_next(start: Callable[..., Node]) -> None:
    killed, living = start("work:=none"), start("work:=none")
    killed.wait_for(r"ready")
    living.wait_for(r"ready")
    left, used = segments_of(killed), segments_of(living)
    assert sum(path.stat().st_size for path in left) > 2**26
    killed.end(signal.SIGKILL)
    assert all(path.exists() for path in left)
    start("work:=none").wait_for(r"ready")
    assert not any(path.exists() or path.with_name(f"{path.name}_el").exists() for path in left - used)
    assert all(path.exists() for path in used - left), "a living node maps those of the killed one, too"


def test_a_node_that_ends_gives_its_shared_memory_back(start: Callable[..., Node]) -> None:
    node = start("work:=none")
    node.wait_for(r"ready")
    segments = segments_of(node)
    assert segments and all(segment.exists() for segment in segments)
    assert node.end(signal.SIGINT) == 0
    assert not any(segment.exists() for segment in segments)


def test_what_modules_without_ros_log_is_said_by_the_node(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    start("work:=thread").wait_for("ready")
    qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    said: list[tuple[int, str, str]] = []
    ros_client.node.create_subscription(
        Log, "/rosout", lambda log: said.append((log.level, log.name, log.msg)), qos
    )
    lost = [
        (Log.WARN, "work_node", "the connection is lost"),
        (Log.ERROR, "work_node", "the connection is lost for good"),
    ]
    wait_until(lambda: set(lost) <= set(said))

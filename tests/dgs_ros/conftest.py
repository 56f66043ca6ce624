"""The node of node_under_test.py as a process of its own."""

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

from tests.support.environment import GUARD, ros_environment
from tests.support.processes import END

SCRIPT = Path(__file__).with_name("node_under_test.py")


class Node:
    """The node's process; its output goes to a file."""

    def __init__(self, arguments: list[str], log_file: Path, domain_id: int):
        self.log_file = log_file
        command = [sys.executable, str(SCRIPT), "--ros-args"]
        for argument in arguments:
            command += argument.split() if argument.startswith("-") else ["-p", argument]
        path = os.pathsep.join(p for p in sys.path if p)
        environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain_id), "PYTHONPATH": path}
        with log_file.open("wb") as log:
            self.process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)

    def log(self) -> str:
        return self.log_file.read_text()

    def wait_for(self, pattern: str) -> None:
        end = time.monotonic() + GUARD
        while not re.search(pattern, self.log()):
            assert self.process.poll() is None, f"ended with {self.process.poll()}\n{self.log()}"
            assert time.monotonic() < end, f"no {pattern!r} within {GUARD} s\n{self.log()}"
            time.sleep(0.02)

    def end(self, number: signal.Signals) -> int:
        """Exit code after a signal."""
        self.process.send_signal(number)
        return self.process.wait(END)


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

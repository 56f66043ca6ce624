"""All nodes of the simulated suite as processes that can be killed and started again."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from dgs_interfaces.action import ClearTable
from dgs_interfaces.srv import SimReset

from dgs_bringup.nodes import MODES
from dgs_bringup.wait_ready import missing
from dgs_ros.presence import watch_server
from tests.support.environment import REPO_ROOT
from tests.support.processes import NodeProcess
from tests.support.ros_client import RosClient

SUITE_FILE = REPO_ROOT / "ros2_ws/src/dgs_bringup/config/suite.yaml"


class Suite:
    """The six nodes with `config/suite.yaml`; a context manager that starts them and waits until all are ready.

    Attributes:
        domain_id: the ROS domain of its nodes.
        nodes: the process of every node by its name.
        client: a session in the suite's domain.
    """

    def __init__(
        self, domain_id: int, client: RosClient, logs: Path, parameters: Mapping[str, Mapping[str, Any]]
    ) -> None:
        """`parameters`: by node, what differs from the file."""
        self.client = client
        self.nodes: dict[str, NodeProcess] = {}
        self.domain_id, self._logs, self._parameters = domain_id, logs, parameters
        self._started = 0

    def start(self, name: str) -> NodeProcess:
        """Start a node, also one that was killed."""
        (info,) = [info for info in MODES["simulation"] if info.name == name]
        self._started += 1
        node = NodeProcess(
            info.package,
            name,
            domain_id=self.domain_id,
            log_file=self._logs / f"{self._started:03d}_{name}.log",
            params_file=SUITE_FILE,
            # A value without the node's name would lose against the node's section of the file.
            parameters={f"{name}:{key}": value for key, value in self._parameters.get(name, {}).items()},
        )
        node.start()
        self.nodes[name] = node
        return node

    def wait_ready(self) -> None:
        """Until every node has said so and all that they offer is there; discovery also knows one just killed."""
        for node in self.nodes.values():
            node.wait_for_log(r"\]: ready")
        self.nodes["clear_table"].wait_ready(lambda: not missing(self.client.node, "simulation"))

    def reset(self, seed: int, objects: int) -> None:
        """Put a new scene on the table."""
        request = SimReset.Request(seed=seed, objects=objects)
        answer = self.client.call(SimReset, "/sim/reset", request)
        assert answer.error_code == 0, answer.message

    def clear(self, **goal: Any) -> Run:
        """Send a goal to /clear_table."""
        return Run(self.client, ClearTable.Goal(**goal))

    def __enter__(self) -> Self:
        for info in MODES["simulation"]:
            self.start(info.name)
        self.wait_ready()
        return self

    def __exit__(self, *exception: object) -> None:
        for node in self.nodes.values():
            node.__exit__()


class Run:
    """A goal of /clear_table under way."""

    def __init__(self, client: RosClient, goal: ClearTable.Goal) -> None:
        self.stages: list[str] = []
        self._client = client
        self.server = watch_server(client.node, "/clear_table")
        self.handle = client.send(ClearTable, "/clear_table", goal, self._note)
        self.future = self.handle.get_result_async()

    def _note(self, message: Any) -> None:
        self.stages.append(message.feedback.stage)

    def reaches(self, stage: str, node: NodeProcess) -> bool:
        """Wait until a stage has begun; whether it did before the run's end."""
        node.wait_ready(lambda: stage in self.stages or self.future.done())
        return stage in self.stages

    def wait_for(self, stage: str, node: NodeProcess) -> None:
        """Until a stage has begun; fails if the run ends before."""
        assert self.reaches(stage, node), f"{self.stages}: {self.end()}"

    def end(self) -> ClearTable.Result:
        """Its result."""
        return self._client.wait(self.future, what="/clear_table").result

    def end_after(self, moment: float) -> tuple[ClearTable.Result, float]:
        """Its result, and how long after a moment (of time.monotonic) it came [s]."""
        result = self.end()
        return result, time.monotonic() - moment

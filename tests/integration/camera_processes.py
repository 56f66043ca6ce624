"""What the tests of camera node and recorder share: the node as a process, its clouds, its diagnostics."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from dgs_description.cell import CELL
from tests.support.environment import GUARD
from tests.support.processes import NodeProcess, suite_node
from tests.support.ros_client import RosClient


@contextmanager
def camera_node(domain_id: int, folder: Path, **parameters: Any) -> Iterator[NodeProcess]:
    with suite_node("camera_node", domain_id, folder, parameters) as node:
        node.wait_for_log("ready")
        yield node


def table_clouds(count: int, points: int) -> list[np.ndarray]:
    """Clouds inside the workspace; the first point of cloud k tells k."""
    lower, upper = CELL.workspace_bounds
    clouds = [
        np.random.default_rng(k).uniform(lower, upper, (points, 3)).astype(np.float32) for k in range(count)
    ]
    for k, cloud in enumerate(clouds):
        cloud[0] = [0.3, 0.001 * k, 0.0]
    return clouds


class Diagnostics:
    """The newest status of a node, and waiting for one."""

    def __init__(self, client: RosClient, name: str = "camera_node") -> None:
        self._name, self._newest = name, threading.Condition()
        self._status: DiagnosticStatus | None = None
        client.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_array, 10)

    def _on_array(self, array: DiagnosticArray) -> None:
        with self._newest:
            for status in array.status:
                if status.name == self._name:
                    self._status = status
                    self._newest.notify_all()

    def says(self, code: int) -> bool:
        """Whether the node's newest status has this code."""
        values = [] if self._status is None else self._status.values
        return any((entry.key, entry.value) == ("code", str(code)) for entry in values)

    def wait_for_clouds(self, count: int, timeout: float = GUARD, key: str = "clouds") -> None:
        """Until the node says that it has had so many."""

        def fits() -> bool:
            values = {} if self._status is None else {entry.key: entry.value for entry in self._status.values}
            return int(values.get(key, 0)) >= count

        with self._newest:
            assert self._newest.wait_for(fits, timeout), f"not {count} clouds; newest: {self._status}"

    def wait_for(
        self, code: int, sentence: str = "", timeout: float = GUARD, **values: str
    ) -> dict[str, str]:
        found: dict[str, str] = {}

        def fits() -> bool:
            if self._status is None:
                return False
            found.update({entry.key: entry.value for entry in self._status.values})
            return (
                found.get("code") == str(code)
                and sentence in self._status.message
                and all(found.get(key) == value for key, value in values.items())
            )

        with self._newest:
            assert self._newest.wait_for(fits, timeout), (
                f"no code {code} ({sentence}); newest: {self._status}"
            )
        return found

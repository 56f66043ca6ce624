"""A node in the test's own process that talks to the nodes under test."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile

from dgs_bringup.ros_session import RosSession
from tests.support.environment import GUARD


class RosClient(RosSession):
    """A session in the test's domain. Use `client.node` for everything rclpy offers."""

    appear = GUARD

    def __init__(self, domain_id: int, name: str = "test_client") -> None:
        """Remember the domain; entering the context joins it."""
        super().__init__(name, domain_id=domain_id)

    def wait(self, future: Any, timeout: float = GUARD, what: str = "the server") -> Any:
        """As of the base class, at least for `GUARD` seconds."""
        return super().wait(future, max(timeout, GUARD), what)

    def run_action(self, kind: Any, name: str, goal: Any, feedback: Callable | None = None) -> Any:
        """Send a goal, wait for its end, return the wrapped result (`.status`, `.result`). Raises TimeoutError."""
        return self.wait(self.send(kind, name, goal, feedback).get_result_async(), GUARD, name)

    def collect(self, message_type: Any, topic: str, count: int = 1, qos: QoSProfile | int = 10) -> list[Any]:
        """Subscribe and return the next `count` messages of a topic. Raises TimeoutError."""
        messages: list[Any] = []
        enough = threading.Event()

        def take(message: Any) -> None:
            messages.append(message)
            if len(messages) >= count:
                enough.set()

        subscription = self.node.create_subscription(message_type, topic, take, qos)
        try:
            if not enough.wait(GUARD):
                raise TimeoutError(f"{len(messages)} of {count} messages on {topic} within {GUARD} s")
            return messages[:count]
        finally:
            self.node.destroy_subscription(subscription)

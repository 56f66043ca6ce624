"""A node in the test's own process that talks to the nodes under test."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from dgs_ros.base_node import SafeActionClient


class RosClient:
    """A context manager around an rclpy node of a given domain that spins in a thread of its own.

    Use `client.node` for everything rclpy offers; the methods are for what every integration test does.
    """

    def __init__(self, domain_id: int, name: str = "test_client") -> None:
        """Remember the domain; entering the context joins it."""
        self._domain_id = domain_id
        self._name = name

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain_id)
        self.node: Node = rclpy.create_node(self._name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._context.try_shutdown()
        self._thread.join(timeout=5.0)
        self._executor.shutdown(timeout_sec=5.0)
        self.node.destroy_node()

    def _spin(self) -> None:
        while self._context.ok():
            try:
                self._executor.spin()
            except rclpy.executors.ExternalShutdownException:
                return
            except InvalidHandle:
                # rclpy trips over a subscription that another thread destroys while it builds its wait set: go on.
                pass

    def wait(self, future: Any, timeout: float = 10.0) -> Any:
        """Wait for an rclpy future and return its result. Raises TimeoutError."""
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        if not done.wait(timeout):
            raise TimeoutError(f"no answer within {timeout} s")
        return future.result()

    def call(self, service_type: Any, name: str, request: Any, timeout: float = 10.0) -> Any:
        """Wait for the service, call it, return the response. Raises TimeoutError."""
        client = self.node.create_client(service_type, name)
        try:
            if not client.wait_for_service(timeout_sec=timeout):
                raise TimeoutError(f"no service {name} within {timeout} s")
            return self.wait(client.call_async(request), timeout)
        finally:
            self.node.destroy_client(client)

    def run_action(
        self, action_type: Any, name: str, goal: Any, timeout: float = 60.0, feedback: Callable | None = None
    ) -> Any:
        """Send a goal, wait for its end, return the wrapped result (`.status`, `.result`). Raises TimeoutError.

        A refused goal returns None.
        """
        client = SafeActionClient(self.node, action_type, name)
        try:
            if not client.wait_for_server(timeout_sec=min(timeout, 10.0)):
                raise TimeoutError(f"no action server {name}")
            handle = self.wait(client.send_goal_async(goal, feedback_callback=feedback), timeout)
            return self.wait(handle.get_result_async(), timeout) if handle.accepted else None
        finally:
            client.destroy()

    def collect(
        self, message_type: Any, topic: str, count: int = 1, timeout: float = 10.0, qos: QoSProfile | int = 10
    ) -> list[Any]:
        """Subscribe and return the next `count` messages of a topic. Raises TimeoutError."""
        messages: list[Any] = []
        subscription = self.node.create_subscription(message_type, topic, messages.append, qos)
        try:
            end = time.monotonic() + timeout
            while len(messages) < count:
                if time.monotonic() > end:
                    raise TimeoutError(f"{len(messages)} of {count} messages on {topic} within {timeout} s")
                time.sleep(0.01)
            return messages[:count]
        finally:
            self.node.destroy_subscription(subscription)

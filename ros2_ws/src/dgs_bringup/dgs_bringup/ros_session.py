"""A spinning rclpy node for a program that asks and waits: the demo, plan_pick, trials."""

from __future__ import annotations

import faulthandler
import threading
import time
from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter

from dgs_bringup.nodes import who_offers
from dgs_ros.action_client import SafeActionClient
from dgs_ros.executors import SessionExecutor
from dgs_ros.presence import watch_server
from dgs_ros.run import STUCK, destroy

ANSWER = 120.0
"""Wait for an answer [s]."""


class RosSession:
    """Context manager: a node that spins in a thread of its own. Its methods block, so call them from the main thread.

    Attributes:
        node: the node.
        appear: wait for a server [s].
    """

    node: Node
    appear = 10.0

    def __init__(self, name: str, *, use_sim_time: bool = False, domain_id: int | None = None) -> None:
        """Nothing is started yet; `domain_id` None is that of the environment."""
        self._name, self._use_sim_time, self._domain_id = name, use_sim_time, domain_id
        self._clients: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        signals = rclpy.signals.SignalHandlerOptions.NO
        rclpy.init(context=self._context, domain_id=self._domain_id, signal_handler_options=signals)
        sim_time = Parameter("use_sim_time", value=self._use_sim_time)
        self.node = rclpy.create_node(self._name, context=self._context, parameter_overrides=[sim_time])
        self._executor = SessionExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="spin", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        faulthandler.dump_traceback_later(2 * STUCK, exit=True, file=2)  # stderr
        self._context.try_shutdown()
        self._thread.join(timeout=5.0)
        self._executor.shutdown(timeout_sec=5.0)
        destroy(self.node)
        faulthandler.cancel_dump_traceback_later()

    def wait(self, future: Any, timeout: float = ANSWER, what: str = "the server") -> Any:
        """Result of an rclpy future. Raises TimeoutError that names `what`."""
        if not wait_until(future.done, timeout) or future.cancelled():
            raise TimeoutError(f"{what} gave no answer within {timeout:g} s")
        return future.result()

    def call(self, kind: Any, name: str, request: Any, timeout: float = ANSWER) -> Any:
        """Answer of a service. Raises TimeoutError if it does not appear or does not answer."""
        client = self._clients.get(name) or self.node.create_client(kind, name)
        self._clients[name] = client
        return self._ask(name, client.service_is_ready, lambda: client.call_async(request), timeout)

    def send(self, kind: Any, name: str, goal: Any, feedback: Callable[[Any], None] | None = None) -> Any:
        """Handle of an accepted goal of an action. Raises TimeoutError if nobody takes it."""
        client = self._clients.get(name) or SafeActionClient(self.node, kind, name)
        self._clients[name] = client
        handle = self._ask(
            name,
            client.server_is_ready,
            lambda: client.send_goal_async(goal, feedback_callback=feedback),
            ANSWER,
        )
        if not handle.accepted:
            raise TimeoutError(f"{name} refused the goal; its log says why")
        return handle

    def _ask(self, name: str, ready: Callable[[], bool], send: Callable[[], Any], timeout: float) -> Any:
        """What a server answers; one that is restarted meanwhile is asked again: what the old one was sent is lost."""
        end = time.monotonic() + timeout
        while True:
            if not wait_until(ready, self.appear):
                raise TimeoutError(f"nobody serves {name}: start {who_offers(name)}")
            server, future = watch_server(self.node, name), send()
            left = end - time.monotonic()
            if not wait_until(lambda: future.done() or server.lost(), left):  # noqa: B023
                raise TimeoutError(f"{name} gave no answer within {timeout:g} s")
            if future.done():
                return future.result()

    def _spin(self) -> None:
        while self._context.ok():
            try:
                self._executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:  # a bad message must not end the program
                if not self._context.ok():
                    return
                self.node.get_logger().warning(f"a callback failed: {error!r}")


def wait_until(condition: Callable[[], Any], timeout: float, period: float = 0.02) -> bool:
    """True as soon as the condition holds, False after `timeout` [s]."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(period)
    return True

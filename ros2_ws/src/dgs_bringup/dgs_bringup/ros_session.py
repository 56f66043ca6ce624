"""A spinning rclpy node for a program that waits for answers: the demo and the readiness check."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter


class RosSession:
    """Context manager: a node that spins in a thread of its own. Its methods block, so call them from the main thread.

    Attributes:
        node: the node.
    """

    node: Node

    def __init__(self, name: str, use_sim_time: bool = False) -> None:
        """Nothing is started yet; `use_sim_time`: the node's clock follows /clock."""
        self._name, self._use_sim_time = name, use_sim_time

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        sim_time = Parameter("use_sim_time", value=self._use_sim_time)
        self.node = rclpy.create_node(self._name, context=self._context, parameter_overrides=[sim_time])
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="spin", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._executor.shutdown(timeout_sec=2.0)
        self._context.try_shutdown()
        self._thread.join(timeout=2.0)

    def wait(self, future: Any, timeout: float, what: str) -> Any:
        """Result of an rclpy future. Raises TimeoutError that names `what`."""
        if not wait_until(lambda: future.done() or future.cancelled(), timeout) or future.cancelled():
            raise TimeoutError(f"{what} gave no answer within {timeout:g} s")
        return future.result()

    def _spin(self) -> None:
        while self._context.ok():
            try:
                self._executor.spin()
            except ExternalShutdownException:
                return
            except Exception as error:  # a bad message must not end the demo
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

"""The two executors of a node: one thread for messages that come all the time, a pool for callbacks that take long.

rclpy's MultiThreadedExecutor looks at every entity of the node, hands the callback to another thread and looks at every
entity again: with /clock and joint states at 100 Hz and more, that alone fills a core. So the few entities that bring
messages all the time have a thread of their own, and the pool sleeps meanwhile.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node

POOL_THREADS = 4
"""Callbacks that may take long and run at the same time."""


class SteadyExecutor(Executor):
    """Goes on when another thread destroys an entity.

    rclpy (Jazzy) forgets a destroyed subscription, but stumbles over its events, which are entities as well, when it
    makes its list of what to wait for and when it takes what has come.
    """

    def wait_for_ready_callbacks(self, *args: Any, **keywords: Any) -> Any:
        """As of rclpy; what is destroyed is not waited for."""
        while True:
            try:
                return super().wait_for_ready_callbacks(*args, **keywords)
            except InvalidHandle:
                continue

    def _take_waitable(self, waitable: Any) -> Any:
        try:
            return super()._take_waitable(waitable)
        except InvalidHandle:
            return None


class SessionExecutor(SteadyExecutor, SingleThreadedExecutor):
    """Runs the callbacks of a program that asks and waits, one after another."""


class StreamGroup(ReentrantCallbackGroup):
    """Callbacks that come often and return at once. They run one after another in the thread of a `StreamExecutor`."""


class StreamExecutor(SteadyExecutor, SingleThreadedExecutor):
    """Runs the callbacks of a node's stream groups, and only those."""

    def __init__(self, node: Node) -> None:
        """Serve `node`, which belongs to another executor at the same time."""
        super().__init__(context=node.context)
        self._node = node

    def get_nodes(self) -> list[Node]:
        """The one node."""
        return [self._node]

    def can_execute(self, entity: Any) -> bool:
        """Whether it is a stream that does not run yet."""
        return isinstance(entity.callback_group, StreamGroup) and super().can_execute(entity)


class PoolExecutor(SteadyExecutor, MultiThreadedExecutor):
    """Runs all other callbacks of a node in a pool of threads, so that they may take their time."""

    def __init__(self, node: Node, threads: int = POOL_THREADS) -> None:
        super().__init__(threads, context=node.context)
        self.add_node(node)

    def can_execute(self, entity: Any) -> bool:
        """Whether it is not a stream, and its callback group lets it run."""
        return not isinstance(entity.callback_group, StreamGroup) and super().can_execute(entity)

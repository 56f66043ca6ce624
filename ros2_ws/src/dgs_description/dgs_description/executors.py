"""Who runs a node's callbacks: streams in one light thread, everything else in a pool of threads.

rclpy's `MultiThreadedExecutor` looks at every entity of the node, hands the callback to another thread and looks at
every entity again. With /clock and joint states at 100 Hz and more that alone fills a core (measured: 7 ms of processor
time per message on a node with six services and two actions). `StreamExecutor` waits for the few entities that bring
messages all the time and runs their callbacks itself; the pool sleeps meanwhile.
"""

from __future__ import annotations

from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node


class StreamGroup(ReentrantCallbackGroup):
    """Callbacks that come often and return at once. They run one after another in the thread of a `StreamExecutor`."""


class StreamExecutor(SingleThreadedExecutor):
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


class PoolExecutor(MultiThreadedExecutor):
    """Runs all other callbacks in a pool of threads, so that they may take their time."""

    def can_execute(self, entity: Any) -> bool:
        """Whether it is not a stream, and its callback group lets it run."""
        return not isinstance(entity.callback_group, StreamGroup) and super().can_execute(entity)

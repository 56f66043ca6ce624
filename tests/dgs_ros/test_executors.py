"""Streams flow in a thread of their own, whatever the pool is busy with."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import Int32

from dgs_ros.base_node import DgsNode
from dgs_ros.executors import POOL_THREADS, PoolExecutor, SessionExecutor, StreamExecutor
from tests.support.environment import GUARD

pytestmark = pytest.mark.integration


@dataclass(frozen=True)
class NoParameters:
    """The node needs none."""


@pytest.fixture
def node(ros_domain_id: int) -> Iterator[DgsNode]:
    """A node that is being served, with a publisher of its own."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain_id)
    node = DgsNode("streams", NoParameters, context=context)
    executors = node.make_executors()
    threads = [threading.Thread(target=executor.spin, daemon=True) for executor in executors]
    for thread in threads:
        thread.start()
    yield node
    for executor in executors:
        executor.shutdown(timeout_sec=2.0)
    for thread in threads:
        thread.join(2.0)
        assert not thread.is_alive()
    node.destroy_node()
    context.try_shutdown()


def test_streams_flow_while_every_thread_of_the_pool_is_busy(node: DgsNode) -> None:
    release, came = threading.Event(), threading.Event()
    busy = threading.Semaphore(0)
    names: set[str] = set()

    def block(_: Int32) -> None:
        busy.release()
        release.wait(2 * GUARD)

    def note(_: Int32) -> None:
        names.add(threading.current_thread().name)
        came.set()

    publisher = node.create_publisher(Int32, "numbers", 10)
    for _ in range(POOL_THREADS):
        node.create_subscription(Int32, "numbers", block, 10, callback_group=ReentrantCallbackGroup())
    node.create_timer(0.05, lambda: publisher.publish(Int32()), callback_group=node.streams)
    try:
        for _ in range(POOL_THREADS):
            assert busy.acquire(timeout=GUARD)
        node.create_subscription(Int32, "numbers", note, 10)
        assert came.wait(GUARD), "a subscription made while the pool is busy gets its messages"
    finally:
        release.set()
    assert len(names) == 1


def test_what_has_a_group_of_its_own_belongs_to_the_pool_and_the_rest_to_the_streams(node: DgsNode) -> None:
    stream = node.create_subscription(Int32, "a", lambda _: None, 10)
    own = node.create_subscription(
        Int32, "b", lambda _: None, 10, callback_group=MutuallyExclusiveCallbackGroup()
    )
    streams, pool = StreamExecutor(node), PoolExecutor(node)
    try:
        assert streams.can_execute(stream) and not pool.can_execute(stream)
        assert pool.can_execute(own) and not streams.can_execute(own)
        assert streams.get_nodes() == [node]
    finally:
        streams.shutdown()
        pool.shutdown()


class Destroyer(Waitable):
    """Destroys a subscription when another thread may: the executor has listed it, and looks at it now."""

    def __init__(self, node: DgsNode) -> None:
        super().__init__(ReentrantCallbackGroup())
        self._node = node
        node.add_waitable(self)
        own = ReentrantCallbackGroup()
        self.subscription = node.create_subscription(Int32, "a", lambda _: None, 10, callback_group=own)

    def __enter__(self) -> None:
        self._node.destroy_subscription(self.subscription)

    def __exit__(self, *_: object) -> None:
        """Nothing was entered."""

    def add_to_wait_set(self, wait_set: Any) -> None:
        """There is nothing to wait for."""

    def is_ready(self, wait_set: Any) -> bool:
        return False

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities()


@pytest.mark.parametrize("kind", [PoolExecutor, lambda node: SessionExecutor(context=node.context)])
def test_a_subscription_may_go_while_the_executor_looks(ros_domain_id: int, kind: Callable) -> None:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=ros_domain_id)
    node = DgsNode("goes", NoParameters, context=context)
    Destroyer(node)
    executor = kind(node)
    executor.add_node(node)
    executor.spin_once(timeout_sec=0.1)  # no InvalidHandle
    assert [name for name, _ in node.get_topic_names_and_types() if name == "/a"] == []
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()

"""Streams flow in a thread of their own, whatever the pool is busy with."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from std_msgs.msg import Int32

from dgs_ros.base_node import DgsNode
from dgs_ros.executors import POOL_THREADS, PoolExecutor, StreamExecutor
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

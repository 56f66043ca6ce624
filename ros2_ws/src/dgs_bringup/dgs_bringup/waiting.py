"""Waiting inside coroutines of an rclpy executor, never without a time limit."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future


class Waiter:
    """Awaitable waits of one node. Limits are wall time: they must pass also while simulated time stands still."""

    def __init__(self, node: Node, group: CallbackGroup) -> None:
        """Timers are created on `node` in `group`, which must be reentrant."""
        self._node = node
        self._group = group
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)

    async def until(self, predicate: Callable[[], Any], timeout: float, period: float = 0.05) -> bool:
        """True as soon as `predicate` says yes (asked every `period`), False after `timeout` [s]."""
        if predicate():
            return True
        answer: Future = Future()
        end = time.monotonic() + timeout

        def look() -> None:
            if answer.done():
                return
            if predicate():
                answer.set_result(True)
            elif time.monotonic() >= end:
                answer.set_result(False)

        timer = self._node.create_timer(period, look, callback_group=self._group, clock=self._clock)
        try:
            return bool(await answer)
        finally:
            self._node.destroy_timer(timer)

    async def first(self, *futures: Future, timeout: float) -> bool:
        """True when one of the futures is done, False after `timeout` [s]."""
        return await self.until(
            lambda: any(future.done() or future.cancelled() for future in futures), timeout, 0.02
        )

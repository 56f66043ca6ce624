"""Time per named stage of a piece of work."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


class StageClock:
    """Adds up seconds per stage. A stage within a stage counts for itself only: the stages add up.

    Attributes:
        times: seconds by stage, in the order in which the stages were first left.
    """

    def __init__(self, now: Callable[[], float] = time.perf_counter):
        """`now`: the clock, wall time unless said (`time.process_time` counts processor time)."""
        self.times: dict[str, float] = {}
        self._now = now
        self._start = now()
        self._inner = 0.0

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block, less that of stages within it, to `stage`."""
        outer, self._inner, start = self._inner, 0.0, self._now()
        try:
            yield
        finally:
            spent = self._now() - start
            self.times[stage] = self.times.get(stage, 0.0) + spent - self._inner
            self._inner = outer + spent

    def finish(self) -> dict[str, float]:
        """The stages, and `total` since the clock was made."""
        return {**self.times, "total": self._now() - self._start}

"""Keeps count of what a camera delivers and says in one sentence how it is doing."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from dgs_description.errors import DgsError, ErrorCode
from dgs_perception.workspace import CropCounts

RATE_WINDOW = 30
"""Clouds over which the rate is averaged."""
PROBLEM_MEMORY = 3.0
"""Without clouds, a problem is reported for at least so long before the source counts as silent [s]."""


@dataclass(frozen=True)
class HealthReport:
    """State of the camera.

    Attributes:
        code: SUCCESS while clouds come, else what is wrong.
        sentence: for people.
        degraded: clouds come, but input was skipped since the last report.
        values: figures for the diagnostics.
    """

    code: ErrorCode
    sentence: str
    degraded: bool
    values: dict[str, Any]


class CameraHealth:
    """Told of every cloud and every problem, from any thread; asked now and then for a report."""

    def __init__(
        self, source: str, silence_timeout: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`source`: where clouds come from, in words; without a cloud for `silence_timeout` [s] it is silent."""
        self._source, self._timeout, self._clock = source, silence_timeout, clock
        self._lock = threading.Lock()
        self._last = clock()
        self._arrivals: deque[float] = deque(maxlen=RATE_WINDOW)
        self._published = self._skipped = 0
        self._problem: DgsError | None = None
        self._problem_at = -float("inf")
        self._new_problem = False
        self._idle = ""
        self._age = 0.0
        self._figures: dict[str, Any] = {}

    def cloud(self, counts: CropCounts, seconds: float, age: float) -> None:
        """A cloud was published, on which `seconds` were spent, `age` after its stamp [s]."""
        with self._lock:
            self._last = self._clock()
            self._arrivals.append(self._last)
            self._published += 1
            self._figures = {f"points_{name}": value for name, value in asdict(counts).items()}
            self._figures["processing_ms"] = round(seconds * 1e3, 2)
            self._age = age

    def skipped(self, problem: DgsError) -> bool:
        """An input was not used, or the source cannot be opened; True if the problem is news worth logging."""
        with self._lock:
            self._skipped += 1
            news = str(self._problem) != str(problem)
            self._problem, self._problem_at, self._new_problem = problem, self._clock(), True
            return news

    def idle(self, sentence: str) -> None:
        """The source has a reason for its silence; an empty sentence means that it works from now on."""
        with self._lock:
            self._idle = sentence
            self._last = self._clock()

    def resumed(self) -> None:
        """Silence counts from now on."""
        with self._lock:
            self._last = self._clock()

    def report(self) -> HealthReport:
        """The state since the last report; a problem that is over is mentioned once."""
        with self._lock:
            now = self._clock()
            code, sentence, degraded = self._judge(now)
            self._new_problem = False
            if not degraded:
                self._problem = None  # seen working: the same problem later is news
            silent_for = now - self._last
            values: dict[str, Any] = {
                "source": self._source,
                "code": int(code),
                "clouds": self._published,
                "skipped": self._skipped,
                "rate_hz": round(self._rate(now), 2),
            }
            if self._published:
                values |= {"age_s": round(self._age + silent_for, 3), **self._figures}
            return HealthReport(code, sentence, degraded, values)

    def _judge(self, now: float) -> tuple[ErrorCode, str, bool]:
        """Code, sentence, degraded."""
        silent_for, problem = now - self._last, self._problem
        if silent_for <= self._timeout and self._published and not self._idle:
            if problem is not None and self._new_problem:
                return ErrorCode.SUCCESS, f"Input was skipped: {problem.message}", True
            return ErrorCode.SUCCESS, f"Clouds come from {self._source}.", False
        if problem is not None and now - self._problem_at <= max(self._timeout, PROBLEM_MEMORY):
            return problem.code, problem.message, True
        if self._idle:
            return ErrorCode.SUCCESS, self._idle, False
        if silent_for <= self._timeout:
            return ErrorCode.SUCCESS, f"Waiting for the first input from {self._source}.", False
        silence = f"No input from {self._source} for {silent_for:.1f} s; is it running and connected?"
        return ErrorCode.CAMERA_SILENT, silence, True

    def _rate(self, now: float) -> float:
        # Until now, not until the last arrival: the figure must fall when the source stops.
        several = len(self._arrivals) > 1
        return (len(self._arrivals) - 1) / max(now - self._arrivals[0], 1e-9) if several else 0.0

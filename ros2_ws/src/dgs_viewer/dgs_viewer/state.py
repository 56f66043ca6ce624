"""What the page shows: the newest of everything, and how it was before. No ROS, no drawing."""

from __future__ import annotations

import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import HOME_ARM
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

SAMPLES = 6000
"""So many moments are remembered: ten minutes at ten a second."""
KEPT_EVERY = 2.0
"""Time between remembered clouds [s]; the newest one is always shown live."""
EVENTS = 200
SILENT = 5.0
"""A status that is not repeated for so long says nothing of now [s]: nodes repeat theirs every second."""
OK = 0


@dataclass(frozen=True)
class Cloud:
    """What the camera sees: points (N, 3) float16 in `base_link` [m], colours (N, 3) uint8."""

    points: NDArray[np.float16]
    colours: NDArray[np.uint8]


@dataclass(frozen=True)
class Offer:
    """Predicted hands, and what the arm made of them.

    Attributes:
        grasps: in `base_link`, best first.
        chosen: index of the one that is executed; -1 = none, or nobody has asked the arm.
        refusals: code and reason by index.
        motions: of the arm, in order: stage and (N, 6) joints [rad].
    """

    grasps: GraspSet
    chosen: int = -1
    refusals: Mapping[int, tuple[int, str]] = field(default_factory=dict)
    motions: tuple[tuple[str, Array], ...] = ()


@dataclass(frozen=True)
class Sample:
    """One moment.

    Attributes:
        time: wall time [s].
        arm, hand: (6,), (J,) joints [rad].
        stage, sentence: what the suite does, in its own words.
        counts: attempts, successes.
        cloud, offer: None = nothing has come yet.
    """

    time: float = 0.0
    arm: Array = field(default_factory=HOME_ARM.copy)
    hand: Array = field(default_factory=HAND.open_hand.copy)
    stage: str = "waiting"
    sentence: str = "no run yet"
    counts: tuple[int, int] = (0, 0)
    cloud: Cloud | None = None
    offer: Offer | None = None


@dataclass(frozen=True)
class Event:
    """One line of the log: wall time [s], level of a diagnostic status, code (0 = none) and sentence."""

    time: float
    level: int
    code: int
    text: str


class ViewerState:
    """Newest values and their history; any thread may call.

    Attributes:
        now: the newest moment.
        events: newest last.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.now = Sample()
        self.events: deque[Event] = deque(maxlen=EVENTS)
        self._health: dict[str, tuple[float, int, int, str]] = {}
        self._history: deque[Sample] = deque(maxlen=SAMPLES)
        self._kept: tuple[float, Cloud | None] = (-np.inf, None)

    def put(self, **values: object) -> None:
        """Replace fields of `now`."""
        with self._lock:
            self.now = replace(self.now, **values)  # type: ignore[arg-type]

    def log(self, time: float, text: str, level: int = OK, code: int = 0) -> None:
        """Write a line; the same sentence twice in a row is one."""
        with self._lock:
            if not self.events or self.events[-1].text != text:
                self.events.append(Event(time, level, code, text))

    def report(self, time: float, component: str, level: int, code: int, sentence: str) -> None:
        """Take in a diagnostic status; what is new and not just fine is logged, too."""
        status = (level, code, sentence)
        with self._lock:
            before = self._health.get(component, (0.0,))[1:]
            self._health[component] = (time, *status)
        if before != status and (level != OK or code != 0):
            self.log(time, f"{component}: {sentence}", level, code)

    def troubles(self) -> list[Event]:
        """What is not well now, by component."""
        with self._lock:
            now = self.now.time
            return [
                Event(now, level, code, f"{name}: {text}")
                for name, (heard, level, code, text) in self._health.items()
                if level != OK and heard >= now - SILENT
            ]

    def tick(self, time: float) -> Sample:
        """Remember `now` as it was at a time; returns it."""
        with self._lock:
            self.now = replace(self.now, time=time)
            if self.now.cloud is not self._kept[1] and time - self._kept[0] >= KEPT_EVERY:
                self._kept = time, self.now.cloud
            self._history.append(replace(self.now, cloud=self._kept[1]))
            return self.now

    def span(self) -> tuple[float, float]:
        """First and last remembered time [s]; zeros at the beginning."""
        with self._lock:
            return (self._history[0].time, self._history[-1].time) if self._history else (0.0, 0.0)

    def at(self, time: float) -> Sample:
        """The remembered moment at or after a time [s]; the newest one if there is none."""
        with self._lock:
            place = bisect_left(self._history, time, key=lambda sample: sample.time)
            return self._history[place] if place < len(self._history) else self.now

    def recent(self, count: int) -> list[Event]:
        """The newest lines of the log, newest first."""
        with self._lock:
            return list(self.events)[: -count - 1 : -1]


class RateMeter:
    """Messages per second by name, over the last full second or more."""

    def __init__(self) -> None:
        self.rates: dict[str, float] = {}
        self._counts: dict[str, int] = {}
        self._since = 0.0

    def count(self, name: str) -> None:
        """One message has come."""
        self._counts[name] = self._counts.get(name, 0) + 1

    def update(self, time: float, least: float = 2.0) -> None:
        """Compute the rates anew if `least` [s] have passed."""
        passed = time - self._since
        if passed < least:
            return
        counts, self._counts, self._since = self._counts, {}, time
        names = self.rates.keys() | counts.keys()
        self.rates = {name: counts.get(name, 0) / passed for name in sorted(names)}

"""The joints of the last seconds, so that a picture can be compared with where the robot was when it was taken."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque

import numpy as np

from dgs_description.frames import Array

_KEPT = 500
"""Measurements: 4 s of a UR that tells its joints 125 times a second."""


class JointHistory:
    """Measurements by time of one source."""

    def __init__(self) -> None:
        self._known: deque[tuple[float, Array]] = deque(maxlen=_KEPT)

    def add(self, stamp: float, joints: Array) -> None:
        """A measurement (N,) [rad] taken at a time [s]; time that goes back (a new simulation) forgets what was."""
        if self._known and stamp < self._known[-1][0]:
            self._known.clear()
        self._known.append((stamp, joints))

    def at(self, stamp: float) -> Array | None:
        """(N,) joints at a time [s], in between linearly; None for a time that the history does not cover."""
        known = list(self._known)
        after = bisect_right(known, stamp, key=lambda entry: entry[0])
        if not known or after == 0 or stamp > known[-1][0]:
            return None
        if after == len(known):
            return known[-1][1]
        (t0, before), (t1, later) = known[after - 1 : after + 1]
        return before + (later - before) * ((stamp - t0) / (t1 - t0))

    def moved(self, window: float) -> float:
        """Largest way of a joint over the newest `window` [s] or a little more [rad]; inf where less is known."""
        known = list(self._known)
        if not known:
            return np.inf
        newest, joints = known[-1]
        before = bisect_right(known, newest - window, key=lambda entry: entry[0])
        return float(np.abs(joints - known[before - 1][1]).max()) if before else np.inf

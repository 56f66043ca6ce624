"""One calm depth image of the last frames: the median of each pixel, where what it sees stands still."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

MOVED = 0.010
"""A pixel whose newest depth is farther than this from the median at 1 m has moved; it grows with the square of the
distance, as the noise of a stereo camera does [1/m]."""


class FramesMedian:
    """Keeps the last frames of one camera that stands still; the arm and what it moves may move.

    A pixel that has moved keeps its newest depth, so nothing that is measured is late. One without depth now takes the
    median if most frames had depth there: what flickers is filled, holes stay, and a new one shows what was there for
    half of the frames.
    """

    def __init__(self, frames: int) -> None:
        """`frames`: so many are looked at, the newest included."""
        self._frames: deque[NDArray[np.float32]] = deque(maxlen=frames)

    def __call__(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """The newest frame (H, W) [m], 0 or NaN = none, calmed; an image of another size begins anew."""
        newest = np.where(np.isfinite(depth), depth, 0.0).astype(np.float32)
        if self._frames and self._frames[-1].shape != newest.shape:
            self._frames.clear()
        self._frames.append(newest)
        # Frames without depth come first; the median is the middle one of those behind them.
        ordered = np.sort(np.stack(self._frames), axis=0)
        there = np.count_nonzero(ordered, axis=0)
        median = np.take_along_axis(ordered, (len(ordered) - 1 - there // 2)[None], axis=0)[0]
        moved = np.abs(newest - median) > MOVED * median * median
        filled = np.where(2 * there > len(ordered), median, np.float32(0.0))
        return np.where(newest == 0.0, filled, np.where(moved, newest, median))

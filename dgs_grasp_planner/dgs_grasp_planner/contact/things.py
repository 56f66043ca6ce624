"""Tells things that touch one another apart: a shape of a height field is split at steps in height and at necks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects, label, maximum_filter, minimum_filter

CELL = 0.003
"""Edge of a height field's cell [m]."""
STEP = 0.015
"""Heights of neighbouring cells that differ by more are of two things, or of one with a step [m]."""
DEEP = 0.012
"""What is farther than this from a shape's border and from steps is the inside of one thing [m]."""
INSIDE = 17
"""Smaller insides are bumps [cells].

Of 71 shapes longer than 110 mm that were one thing, scanned or household, 1 had several insides; of 81 that were
several things, 62.
"""


def separate(owner: NDArray[np.int32], heights: NDArray[np.float32]) -> NDArray[np.int32]:
    """(X, Y) numbers of things instead of shapes: a shape with several insides becomes as many things.

    Args:
        owner: (X, Y) number of the connected shape that covers a cell, 0 = none. Unsplit shapes keep their numbers.
        heights: (X, Y) [m].
    """
    out, free = owner.copy(), int(owner.max(initial=0)) + 1
    for number, window in enumerate(find_objects(owner), start=1):
        if window is None or min(side.stop - side.start for side in window) < 2 * DEEP / CELL:
            continue
        mine = np.pad(owner[window] == number, 1)
        high = np.pad(heights[window], 1)
        step = maximum_filter(np.where(mine, high, -np.inf), 3) - minimum_filter(
            np.where(mine, high, np.inf), 3
        )
        cores, count = label(distance_transform_edt(mine & (step < STEP)) > DEEP / CELL)
        sizes = np.bincount(cores.ravel(), minlength=count + 1)
        sizes[0] = 0
        names = np.zeros(count + 1, owner.dtype)
        kept = np.flatnonzero(sizes >= INSIDE)
        if len(kept) > 1:
            names[kept] = [number, *range(free, free + len(kept) - 1)]
            free += len(kept) - 1
            cores = names[cores]
            nearest = distance_transform_edt(cores == 0, return_distances=False, return_indices=True)
            out[window][mine[1:-1, 1:-1]] = cores[tuple(nearest)][mine]
    return out

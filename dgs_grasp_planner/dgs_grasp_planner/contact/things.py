"""Tells things that touch one another apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, find_objects, label

CELL = 0.003
"""Edge of a height field's cell [m]."""
MIN_CELLS = 8
"""Smaller shapes are noise."""
BORDER = 0.4
"""Probability of a border from which on a cell is no longer the inside of a thing."""
INSIDE = 12
"""Smaller insides are no thing [cells]."""


def split(owner: NDArray[np.int32], border: NDArray[np.float32]) -> NDArray[np.int32]:
    """(X, Y) numbers of things instead of shapes: a shape with several insides becomes as many things.

    Args:
        owner: (X, Y) number of the connected shape that covers a cell, 0 = none. Unsplit shapes keep their numbers.
        border: (X, Y) probability that another thing begins there.
    """
    out, free = owner.copy(), int(owner.max(initial=0)) + 1
    for number, window in enumerate(find_objects(owner), start=1):
        if window is None:
            continue
        mine = owner[window] == number
        insides, count = label(mine & (border[window] < BORDER))
        sizes = np.bincount(insides.ravel(), minlength=count + 1)
        sizes[0] = 0
        kept = np.flatnonzero(sizes >= INSIDE)
        if len(kept) < 2:
            continue
        names = np.zeros(count + 1, owner.dtype)
        names[kept] = [number, *range(free, free + len(kept) - 1)]
        free += len(kept) - 1
        insides = names[insides]
        nearest = distance_transform_edt(insides == 0, return_distances=False, return_indices=True)
        out[window][mine] = insides[tuple(nearest)][mine]
    return out

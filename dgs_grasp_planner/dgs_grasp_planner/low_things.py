"""Finds the whole of what lies flat, where only some of its points stand out of the camera's noise.

Of a mat of 6 mm half of the points are higher than `OBJECT_HEIGHT`, here and there. The mean height of many tells
more than each: what is joined to such points and on average higher than the table is a part of the same thing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label

CELL, BLUR = 0.004, 1.0
"""Edge of a cell [m], and standard deviation of the mean around it [cells]."""
LOWEST, DEVIATIONS = 0.0035, 3.0
"""The mean height from which on a cell may be a part of a thing [m]; at least so many times what it is by noise."""
HIGHEST, SHARE = 0.014, 0.95
"""So much of a low thing is lower than this [m]: of a higher thing the foot is left as it is."""
SURE, SURE_POINTS, AREA = 3, 2, 6e-5
"""A thing has so many cells in which so many points are surely none of the table, and is so large [m2]."""
OWN = 0.75
"""A point of a low thing is higher than this share of the least mean height."""
NEAR_TABLE, MOST_CELLS = 0.03, 1 << 22
"""What is farther from the table's height counts as this far [m]; clouds that cover more cells are left alone."""


def low_things(points: NDArray[np.float32], least: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,) how high each point is no table [m]: `least`, or less at low things.

    Args:
        points: (N, 3) finite, above the table's plane [m].
        least: (N,) height from which on a point by itself is surely none of the table [m].
    """
    rows = np.flatnonzero(np.abs(points[:, 2]) < 0.2)
    if not len(rows):
        return least
    z = points[rows, 2]
    cell = np.floor(points.T[:2].take(rows, axis=1) / CELL).astype(np.int64)
    cell -= cell.min(axis=1, keepdims=True)
    size = cell.max(axis=1) + 1
    if size.prod() > MOST_CELLS:
        return least
    flat = cell[0] * size[1] + cell[1]

    def spread(values: NDArray) -> NDArray[np.float32]:
        total = np.bincount(flat, values, minlength=size.prod()).reshape(size)
        return np.asarray(gaussian_filter(total.astype(np.float32), BLUR))

    count = spread(np.ones(len(z)))
    seen = count > 0.3
    mean = np.where(seen, spread(np.clip(z, -NEAR_TABLE, NEAR_TABLE)) / np.maximum(count, 0.3), 0.0)
    bare = mean[seen & (mean < HIGHEST)]
    if not len(bare):
        return least
    noise = 1.48 * float(np.median(np.abs(bare - np.median(bare))))
    lowest = max(LOWEST, DEVIATIONS * noise)
    shapes, many = label(mean > lowest, structure=np.ones((3, 3)))
    owner = shapes.ravel()[flat]
    sure = np.bincount(flat, z > least[rows], minlength=size.prod()) >= SURE_POINTS
    low = np.bincount(shapes.ravel()[sure], minlength=many + 1) >= SURE
    low &= np.bincount(shapes.ravel(), minlength=many + 1) * CELL**2 >= AREA
    high = np.bincount(owner, z > HIGHEST, minlength=many + 1)
    low &= high <= (1 - SHARE) * np.bincount(owner, minlength=many + 1)
    low[0] = False
    out, mine = least.copy(), rows[low[owner]]
    out[mine] = np.minimum(out[mine], OWN * lowest)
    return out

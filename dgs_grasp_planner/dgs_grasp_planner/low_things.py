"""Finds the whole of what lies flat, where only some of its points stand out of the camera's noise.

Of a mat of 6 mm half of the points are higher than `OBJECT_HEIGHT`, here and there; of the card that a blister pack
stands on hardly one. The mean height of many tells more than each: what is joined to such points and on average higher
than the table is a part of the same thing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening, distance_transform_edt, gaussian_filter, label

CELL, BLUR, CARD_BLUR = 0.004, 1.0, 1.5
"""Edge of a cell [m], and standard deviations of the mean around it, for a mat and for a card [cells]."""
LOWEST, DEVIATIONS = 0.0035, 3.0
"""The mean height from which on a cell may be a part of a thing [m]; at least so many times what it is by noise."""
HIGHEST, SHARE = 0.014, 0.95
"""So much of a low thing is lower than this [m]: of a higher thing the foot is left as it is."""
SURE, SURE_POINTS, AREA = 3, 2, 6e-5
"""A thing has so many cells in which so many points are surely none of the table, and is so large [m2]."""
OWN = 0.75
"""A point of a low thing is higher than this share of the least mean height."""
RING = (0.006, 0.021)
"""A card is looked for so far around a thing: nearer flying pixels hang between it and the table, ..."""
CARD, CARD_POINTS, WIDEST = 0.0014, 60, 0.035
"""... where so many points are on average so much higher than the table; it reaches no farther than the last [m].

Of 531 looks at low things without a card one had more (1.5 mm), of 31 at packs whose card can be seen all had (by hand,
hardware as new). With twice the noise none is found.
"""
NEAR_TABLE, MOST_CELLS = 0.03, 1 << 22
"""What is farther from the table's height counts as this far [m]; clouds that cover more cells are left alone."""


def low_things(points: NDArray[np.float32], least: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,) how high each point is no table [m]: `least`, or less at low things and cards.

    Args:
        points: (N, 3) finite, above the table's plane [m].
        least: (N,) height from which on a point by itself is surely none of the table [m].
    """
    rows = np.flatnonzero(np.abs(points[:, 2]) < 0.2)
    if not len(rows):
        return least
    z = points[rows, 2]
    cell = np.floor(points[rows, :2] / CELL).astype(np.int64)
    cell -= cell.min(axis=0)
    size = cell.max(axis=0) + 1
    if size.prod() > MOST_CELLS:
        return least
    flat = cell[:, 0] * size[1] + cell[:, 1]

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
    high = z > out[rows]
    points, table, sums = (
        np.bincount(flat, weights, size.prod()).reshape(size)
        for weights in (high, ~high, np.where(high, 0.0, z))
    )
    mine = rows[_cards(points >= SURE_POINTS, table, sums).ravel()[flat]]
    out[mine] = np.minimum(out[mine], CARD)
    return out


def _cards(things: NDArray[np.bool_], count: NDArray, total: NDArray) -> NDArray[np.bool_]:
    """(X, Y) cells of the cards that things stand on.

    Args:
        things: (X, Y) where something stands.
        count, total: (X, Y) number of the other points in a cell, and the sum of their heights [m].
    """
    shapes, many = label(things, structure=np.ones((3, 3)))
    away, nearest = distance_transform_edt(~things, CELL, return_indices=True)
    owner = shapes[tuple(nearest)]
    ring = (away > RING[0]) & (away < RING[1])
    seen, height = (np.bincount(owner[ring], layer[ring], many + 1) for layer in (count, total))
    carded = (seen >= CARD_POINTS) & (height > CARD * seen)
    carded &= np.bincount(shapes.ravel(), minlength=many + 1) * CELL**2 >= AREA
    carded[0] = False
    if not carded.any():
        return np.zeros_like(things)
    around = ~things & (away < WIDEST) & carded[owner]
    beyond = around & (away > RING[0])
    many_of, sum_of = (gaussian_filter(np.where(beyond, layer, 0.0), CARD_BLUR) for layer in (count, total))
    whole = things | around & (away <= RING[0]) | beyond & (sum_of > CARD * many_of) & (many_of > 0.1)
    whole = binary_opening(whole, np.ones((3, 3))) | things
    joined, _ = label(whole, structure=np.ones((3, 3)))
    return np.isin(joined, joined[things & carded[shapes]]) & around

"""Tells things apart that touch or lie on one another, and finds the parts of one together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter, label, maximum_filter
from scipy.spatial import cKDTree

CELL = 0.003
"""Edge of a height field's cell [m]."""
MIN_CELLS = 8
"""Smaller shapes are noise."""
BLUR = 3.5
"""Of the votes for a middle, standard deviation [cells]."""
APART = 10
"""Middles that are nearer to one another are one [cells]."""
LEAST = 12
"""Smaller things, and smaller pieces of one, belong to what is around them [cells]."""


def told_apart(owner: NDArray[np.int32], way: NDArray[np.float32]) -> NDArray[np.int32]:
    """(X, Y) number of the thing that covers a cell, 0 = none.

    Every cell votes for the middle of its thing; where the votes gather there is one (Panoptic-DeepLab, Cheng et al.,
    CVPR 2020). So a stick over another is one thing on both sides of it.

    Args:
        owner: (X, Y) > 0 where something stands.
        way: (2, X, Y) from a cell to the middle of its thing [m].
    """
    out = np.zeros_like(owner)
    cells = np.argwhere(owner > 0)
    if not len(cells):
        return out
    votes = cells + way[:, owner > 0].T / CELL
    peaks = _peaks(votes, owner.shape)
    for _ in range(2):  # the second time without those that too few cells are for
        nearest = cKDTree(peaks).query(votes)[1]
        supported = np.bincount(nearest, minlength=len(peaks)) >= LEAST
        if supported.all() or not supported.any():
            break
        peaks = peaks[supported]
    out[owner > 0] = nearest + 1
    return _without_specks(out)


def _peaks(votes: NDArray, size: tuple[int, ...]) -> NDArray[np.int64]:
    """(M, 2) cells in which most votes (N, 2) gather; a middle may lie beyond the grid."""
    beyond = 2 * APART
    cast = np.zeros(np.array(size) + 2 * beyond, dtype=np.float32)
    np.add.at(cast, tuple(np.clip(np.round(votes).astype(int) + beyond, 0, np.array(cast.shape) - 1).T), 1.0)
    gathered = gaussian_filter(cast, BLUR)
    highest = maximum_filter(gathered, 2 * APART + 1)
    return np.argwhere((gathered == highest) & (gathered > 0)) - beyond


def _without_specks(things: NDArray[np.int32]) -> NDArray[np.int32]:
    """Pieces of fewer than `LEAST` cells take the number of the nearest larger piece; numbers are 1 to M again."""
    large = np.zeros(things.shape, dtype=bool)
    for number in range(1, int(things.max()) + 1):
        pieces, count = label(things == number)
        large |= (np.bincount(pieces.ravel(), minlength=count + 1) >= LEAST)[pieces] & (pieces > 0)
    if large.any():
        nearest = distance_transform_edt(~large, return_distances=False, return_indices=True)
        things = np.where(things > 0, things[tuple(nearest)], 0)
    _, numbers = np.unique(things, return_inverse=True)
    return (numbers.reshape(things.shape) + (0 if (things == 0).any() else 1)).astype(things.dtype)

"""Bare clouds: which points are finite, which share a cell of a grid, which belong together."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dgs_description.frames import Array

_COUNTED = 1 << 20
"""Cells up to which counting all of them is faster than sorting the occupied ones."""


def finite_rows(points: NDArray) -> NDArray[np.bool_]:
    """(N,) which of the points (N, 3) have no coordinate that is NaN or infinite."""
    return np.asarray(reduce(np.logical_and, np.isfinite(points).T))


def voxel_means(points: NDArray, edge: float, least: int = 1, place: NDArray | None = None) -> Array:
    """(M, 3) mean of the points (N, 3) of every occupied cube, cubes in ascending order of x, then y, then z [m].

    Args:
        points: finite.
        edge: of the cubes, which have a corner in the frame's origin [m].
        least: cubes with fewer points are left out.
        place: (N, 3) finite, in whose units the cubes are; None = `points`.
    """
    if not len(points):
        return np.zeros((0, 3))
    member, count = _numbered(np.floor((points if place is None else place) / edge))
    sums = [np.bincount(member, weights=points[:, k], minlength=len(count)) for k in range(3)]
    return (np.stack(sums, axis=1) / count[:, None])[count >= least]


def squares(places: NDArray, edge: float) -> NDArray[np.int64]:
    """(N,) number of the square in which each of the places (N, 2), finite, lies; without gaps [m].

    A million squares from the origin on all is one.
    """
    if not len(places):
        return np.zeros(0, np.int64)
    return _numbered(np.clip(np.floor(places / edge), -1e6, 1e6))[0]


def connected(points: NDArray, gap: float) -> NDArray[np.int64]:
    """(N,) number of the thing that each of the points (N, 3) belongs to; closer than `gap` [m] is the same thing."""
    if not len(points):
        return np.zeros(0, np.int64)
    pairs = cKDTree(points).query_pairs(gap, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(len(points), len(points)))
    return np.asarray(connected_components(links, directed=False)[1], np.int64)


def _numbered(cells: NDArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(N,) number of each row's cell of (N, D) whole coordinates, ascending without gaps; (M,) rows of every cell."""
    # Column by column: numpy reduces (N, 3) along either axis ten times more slowly.
    columns = [column.astype(np.int64) for column in cells.T]
    columns = [column - column.min() for column in columns]
    shape = [int(column.max()) + 1 for column in columns]
    number = np.ravel_multi_index(columns, shape)
    if math.prod(shape) > _COUNTED:
        return np.unique(number, return_inverse=True, return_counts=True)[1:]
    count = np.bincount(number)
    return (np.cumsum(count > 0) - 1)[number], count[count > 0]

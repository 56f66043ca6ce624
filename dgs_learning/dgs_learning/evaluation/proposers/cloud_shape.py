"""What a geometric planner makes of a cloud: clusters above the table, and solids under the seen points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, grey_closing
from scipy.spatial import Delaunay, cKDTree

from dgs_description.cloud import connected
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_learning.synthesis.sdf import SignedDistance

CELL = 0.003
"""Edge of the cells of height maps and grids [m]."""
LINK = 0.012
"""Points nearer than this belong to the same cluster [m]."""
MIN_POINTS = 40
HOLLOW = 0.35
"""A shape with less of its inner half covered is hollow."""
MARGIN = 0.036
"""Of the grid around a cluster [m]."""


@dataclass(frozen=True)
class CloudObject:
    """A cluster and the solid that is assumed under it.

    Attributes:
        points: (N, 3) observed points of the cluster [m], frame *table*.
        tops: (M, 3) centres of the cells that it covers, z = height of the solid there [m].
        sdf: distance to all solids in the cluster's neighbourhood, its own and others.
        filled: the same with the cluster's hollow closed by a lid; None where it has no hollow.
    """

    points: Array
    tops: Array
    sdf: SignedDistance
    filled: SignedDistance | None = None


def thinned(points: Array, cell: float) -> Array:
    """One point (the first) per cell of a cubic grid, in the order of the points."""
    keys = np.floor(points / cell).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    return points[np.sort(first)]


def clusters(points: Array) -> list[NDArray[np.int64]]:
    """Euclidean clusters of (N, 3) points [m]: index arrays, the largest first."""
    label = connected(points, LINK)
    sizes = np.bincount(label)
    chosen = [k for k in np.argsort(-sizes, kind="stable") if sizes[k] >= MIN_POINTS]
    return [np.flatnonzero(label == k) for k in chosen]


def height_map(points: Array, low: Array, shape: tuple[int, ...]) -> Array:
    """Highest point per cell, 0 where there is none [m]; gaps one or two cells wide are closed.

    Args:
        points: (N, 3) [m].
        low: (2,) corner of cell (0, 0) [m].
        shape: number of cells in x and y.
    """
    heights = np.zeros(shape)
    cell = np.floor((points[:, :2] - low) / CELL).astype(np.int64)
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    np.maximum.at(heights, tuple(cell[inside].T), points[inside, 2])
    return np.asarray(grey_closing(heights, size=(3, 3)))


def columns_distance(heights: Array, low: Array, top: float) -> SignedDistance:
    """Signed distance to the columns that stand on the table below a height map."""
    floor = -0.03  # below the table, so that no column seems to end there
    z = np.arange(floor, top + MARGIN, CELL)
    filled = (z[None, None] < heights[..., None]) & (heights > 0)[..., None]
    outside, inside = distance_transform_edt(~filled), distance_transform_edt(filled)
    values = np.where(filled, 0.5 - inside, outside - 0.5) * CELL
    origin = np.array([low[0] + CELL / 2, low[1] + CELL / 2, z[0]])
    return SignedDistance(origin, CELL, values.astype(np.float32))


def lid(heights: Array) -> Array | None:
    """The height map with the inside of a high rim filled up to it; None if nothing there is hollow.

    Hollow means that most of the inner half of the shape is missing or much lower than its edge.
    """
    edge = float(np.percentile(heights[heights > 0], 90))
    high = np.argwhere(heights > 0.7 * edge)
    if edge < 0.02 or len(high) < 8 or (np.ptp(high, axis=0) < 4).any():
        return None
    middle = (high.min(axis=0) + high.max(axis=0)) / 2
    radius = np.percentile(np.linalg.norm(high - middle, axis=1), 90) / 2
    every = np.argwhere(np.ones_like(heights, dtype=bool))
    disc = every[np.linalg.norm(every - middle, axis=1) < radius]
    if (heights[tuple(disc.T)] > 0.7 * edge).mean() > HOLLOW or (heights > 0).sum() < 20:
        return None
    inside = every[Delaunay(high).find_simplex(every) >= 0]
    filled = heights.copy()
    filled[tuple(inside.T)] = np.maximum(filled[tuple(inside.T)], edge)
    return filled


def cloud_objects(cloud: NDArray) -> list[CloudObject]:
    """Segment a cloud.

    What stands under an observed point is taken as solid: a depth camera above the table sees the upper side, and from
    above a hand meets nothing else. Sides that no ray reached stay open.

    Args:
        cloud: (N, 3) [m], frame *table*.

    Returns:
        The clusters, the largest first.
    """
    points = np.asarray(cloud, dtype=np.float64)
    points = thinned(points[points[:, 2] > OBJECT_HEIGHT], 0.0015)
    sparse = thinned(points, 0.004)
    groups = clusters(sparse)
    nearest = cKDTree(sparse).query(points)[1] if groups else np.empty(0, int)
    found = []
    for rows in groups:
        own = points[np.isin(nearest, rows)]
        low, high = own[:, :2].min(axis=0) - MARGIN, own[:, :2].max(axis=0) + MARGIN
        shape = tuple(np.ceil((high - low) / CELL).astype(int).tolist())
        heights = height_map(own, low, shape)
        cell = np.argwhere(heights > 0)
        tops = np.column_stack([low + (cell + 0.5) * CELL, heights[tuple(cell.T)]])
        everything, closed = np.maximum(heights, height_map(points, low, shape)), lid(heights)
        top = float(everything.max())
        sdf = columns_distance(everything, low, top)
        filled = None if closed is None else columns_distance(np.maximum(everything, closed), low, top)
        found.append(CloudObject(own, tops, sdf, filled))
    return found

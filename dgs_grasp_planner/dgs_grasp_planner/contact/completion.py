"""The side that the camera cannot see, guessed from symmetry: every shape is mirrored in an upright plane.

Known from Bohg et al., "Mind the gap" (ICRA 2011): most household objects are symmetric, and a mirrored surface is
believable only where the camera could not have seen it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Index = NDArray[np.int64]

LONG = 1.4
"""A shape with a larger ratio of extents is mirrored in a plane along it, others in one across the view."""
MIN_CELLS = 20
TOLERANCE = 0.006
"""Heights of mirrored cells that differ by less agree, by twice as much contradict each other [m]."""
SHADOW = 0.10
"""How far in front of a place something may stand that hides it [m]."""
PLANES, VOTERS = 7, 150
"""Places of the plane that are tried, and cells of a shape that vote."""
BELIEVED = 0.05
"""Mean vote of a shape's cells, from -1 to 1, that a plane needs."""


@dataclass(frozen=True)
class Grid:
    """Cells of a height map.

    Attributes:
        low: (2,) corner of cell (0, 0) [m].
        cell: edge of a cell [m].
        nothing: height of empty cells [m].
    """

    low: Array
    cell: float
    nothing: float

    def middles(self, cells: Index) -> Array:
        """(M, 2) middles of cells (M, 2) [m]."""
        return np.asarray(self.low + (cells + 0.5) * self.cell)

    def cells(self, points: Array) -> Index:
        """(..., 2) cells of points (..., 2) [m], which may lie outside of the map."""
        return np.floor((points - self.low) / self.cell).astype(np.int64)


def complete(heights: Floats, owner: NDArray[np.int32], camera: Array, grid: Grid) -> None:
    """Fill the hidden sides of all shapes, in place.

    Args:
        heights: (X, Y) highest seen point of every cell [m].
        owner: (X, Y) number of the shape that covers a cell, 0 = none.
        camera: (3,) position [m].
        grid: where the cells are.
    """
    cells = np.argwhere(owner > 0)
    number = owner[tuple(cells.T)]
    order = np.argsort(number, kind="stable")
    seen, shadow = heights.copy(), _shadow(heights, camera, grid)
    for rows in np.split(cells[order], np.flatnonzero(np.diff(number[order])) + 1):
        if len(rows) >= MIN_CELLS:
            where, height = _hidden_side(rows, seen, shadow, camera, grid)
            heights[tuple(where.T)] = np.maximum(heights[tuple(where.T)], height)
            owner[tuple(where.T)] = np.where(
                owner[tuple(where.T)] > 0, owner[tuple(where.T)], owner[tuple(rows[0])]
            )


def _hidden_side(
    rows: Index, heights: Floats, shadow: Floats, camera: Array, grid: Grid
) -> tuple[Index, Floats]:
    """Cells (H, 2) that one shape, which covers `rows` (M, 2), also covers unseen, and their heights (H,) [m]."""
    points, own = grid.middles(rows), heights[tuple(rows.T)]
    normal = _plane_normal(points, camera)
    along = points @ normal
    offsets = np.linspace((along.min() + along.max()) / 2, along.max(), PLANES)
    voters = slice(None, None, max(1, len(rows) // VOTERS))
    mirrored = points[voters] + 2 * (offsets[:, None] - along[voters])[..., None] * normal
    _, there, hidden = _look(mirrored, own[voters], heights, shadow, grid)
    agreement = np.maximum(1.0 - np.abs(there - own[voters]) / TOLERANCE, -1.0)
    vote = np.where(hidden & (there < own[voters] - TOLERANCE), 0.0, agreement).mean(axis=1)
    best = int(vote.argmax())
    mirrored = points + 2 * (offsets[best] - along)[:, None] * normal
    cells, there, hidden = _look(mirrored, own, heights, shadow, grid)
    fill = hidden & (there < own) & (vote[best] > BELIEVED)
    return cells[fill], own[fill]


def _look(
    points: Array, own: Floats, heights: Floats, shadow: Floats, grid: Grid
) -> tuple[Index, Floats, NDArray[np.bool_]]:
    """Cells (..., 2) of mirrored points (..., 2), their heights (...), and which could not be seen if `own` high."""
    cells = np.clip(grid.cells(points), 0, np.array(heights.shape) - 1)
    x, y = cells[..., 0], cells[..., 1]
    return cells, heights[x, y], own <= shadow[x, y] + TOLERANCE / 2


def _plane_normal(points: Array, camera: Array) -> Array:
    """(2,) unit normal of the plane, away from the camera."""
    middle = points.mean(axis=0)
    away = middle - camera[:2]
    away = away / max(float(np.linalg.norm(away)), 1e-9)
    value, axes = np.linalg.eigh(np.cov((points - middle).T))
    if value[1] > LONG**2 * max(float(value[0]), 1e-12):
        return np.asarray(axes[:, 0] * (1.0 if axes[:, 0] @ away >= 0 else -1.0))
    return np.asarray(away)


def _shadow(heights: Floats, camera: Array, grid: Grid) -> Floats:
    """(X, Y) height below which cells are hidden from the camera by what stands in front of them [m]."""
    width, depth = heights.shape
    x, y = (np.arange(n, dtype=np.float32) + np.float32(0.5) for n in (width, depth))
    eye = ((camera[:2] - grid.low) / grid.cell).astype(np.float32)
    dx, dy = (eye[0] - x)[:, None], (eye[1] - y)[None]
    distance = np.maximum(np.hypot(dx, dy), np.float32(1e-3))
    dx, dy, slope = dx / distance, dy / distance, np.float32(camera[2] / grid.cell) / distance
    out = np.full(heights.shape, -np.inf, dtype=np.float32)
    for back in np.arange(2, SHADOW / grid.cell, 3, dtype=np.float32):
        i = np.clip(x[:, None] + back * dx, 0, width - 1).astype(np.int32)
        j = np.clip(y[None] + back * dy, 0, depth - 1).astype(np.int32)
        np.maximum(out, heights.take(i * depth + j) - back * np.float32(grid.cell) * slope, out=out)
    return out

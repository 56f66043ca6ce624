"""From a cloud in the table frame to the points the network takes. The same code in training and use; numpy only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgs_description.cloud import finite_rows
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT

TABLE_MARGIN = 0.015
"""Table points this near to an object are kept [m]."""
CELL = 0.01
"""Edge of the cells in which nearness is decided [m]."""
CELL_POINTS = 3
"""Object points that a cell needs before it counts: depth noise of the bare table is thinner."""
LEAST_POINTS = 60
"""Fewer points that are high, in cells most of whose points are, are no object but noise."""
LOWEST = -0.02
"""What is lower than this above the table top is no part of the scene (wrong depth, a hole) [m]."""
MAX_POINTS = 20_000
"""The paper's number of points."""


def check_points(points: NDArray, skip_invalid: bool) -> NDArray:
    """The finite points of a cloud (N, 3).

    Args:
        points: as received.
        skip_invalid: drop single invalid points instead of refusing the cloud.

    Raises:
        DgsError: CLOUD_FORMAT (shape), CLOUD_EMPTY or CLOUD_NOT_FINITE.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud has shape {points.shape}, it must be (N, 3)")
    if len(points) == 0:
        raise DgsError(
            ErrorCode.CLOUD_EMPTY, "the cloud has no points: check the camera and the workspace crop"
        )
    finite = finite_rows(points)
    if finite.all():
        return points
    if not skip_invalid or not finite.any():
        raise DgsError(
            ErrorCode.CLOUD_NOT_FINITE,
            f"{int((~finite).sum())} of {len(points)} points are NaN or infinite: remove them before sending the cloud",
        )
    return points[finite]


def prepare_rows(
    points: NDArray,
    rng: np.random.Generator,
    object_height: float | NDArray = OBJECT_HEIGHT,
    keep_table: bool = False,
    max_points: int = MAX_POINTS,
) -> NDArray[np.int64]:
    """Rows of a cloud that the network gets, in ascending order.

    Args:
        points: (N, 3) finite, in the frame *table* (z = 0 is the table top) [m].
        rng: draws the sample where there are too many.
        object_height: what is lower is table, for all points or (N,) [m].
        keep_table: all table points are kept, as in the paper; else only those near an object.
        max_points: kept at most.

    Raises:
        DgsError: CLOUD_FORMAT (it extends over tens of metres), NO_OBJECTS.
    """
    x, y, z = points.T
    rows = np.flatnonzero(z > LOWEST)
    near, sure = np.zeros(0, bool), 0
    if len(rows):
        near, sure = _near_objects(x[rows], y[rows], (z > object_height)[rows])
    if sure < LEAST_POINTS:
        raise DgsError(
            ErrorCode.NO_OBJECTS,
            f"{sure} points that are no noise stand more than {OBJECT_HEIGHT * 1e3:.0f} mm above the table, "
            f"{LEAST_POINTS} are needed: the table is empty or its height is set wrongly",
        )
    if not keep_table:
        rows = rows[near]
    if len(rows) > max_points:
        rows = np.sort(rng.choice(rows, max_points, replace=False))
    return rows


def _near_objects(x: NDArray, y: NDArray, high: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], int]:
    """Which points, at (N,) x and y, lie near those that are `high`, by dilation on a horizontal grid.

    Also how many of those are surely points of an object.
    """
    reach = int(np.ceil(TABLE_MARGIN / CELL))
    row, column = (np.floor(values / CELL).astype(np.int64) for values in (x, y))
    row -= row.min() - reach
    column -= column.min() - reach
    width = int(column.max()) + 1 + reach
    flat = row * width + column
    cells = (int(row.max()) + 1 + reach) * width
    if cells > 1 << 24:
        raise DgsError(
            ErrorCode.CLOUD_FORMAT, "the cloud extends over tens of metres: crop it to the workspace first"
        )
    object_points = np.bincount(flat[high], minlength=cells)
    counts = object_points >= CELL_POINTS
    seeds = np.flatnonzero(counts)
    step = np.arange(-reach, reach + 1)
    dx, dy = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
    disc = dx * dx + dy * dy <= reach * reach
    near = np.zeros(cells, dtype=bool)
    near[(seeds[:, None] + (dx * width + dy)[disc]).ravel()] = True
    sure = int(object_points[counts & (2 * object_points > np.bincount(flat, minlength=cells))].sum())
    return near[flat], sure

"""From a cloud in the table frame to the points the network takes. The same code in training and use; numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.cloud import finite_rows, squares
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT
from dgs_description.table_fit import TablePlane, fit_plane


@dataclass(frozen=True)
class CloudSettings:
    """What of a cloud is given to the network. Heights are above the table top."""

    max_points: int = 20_000
    """The paper's number of points."""
    keep_table: bool = False
    """Keep all table points, as the paper does; else only those near an object."""
    table_margin: float = 0.015
    """Table points this near to an object are kept [m]."""
    cell: float = 0.01
    """Edge of the cells in which nearness is decided [m]."""
    cell_points: int = 3
    """Object points that a cell needs before it counts: depth noise of the bare table is thinner."""
    min_object_points: int = 60
    """Fewer points that are high, in cells most of whose points are, are no object but noise."""
    lowest: float = -0.02
    """What is lower than this is no part of the scene (wrong depth, a hole) [m]."""


_NEAR_TABLE = 0.025
"""Points this near to where the table should be say where it is [m]."""
_ROUGH = 3.3
"""What stands out of the table by so many times its roughness is no noise."""
_FIT_POINTS = 6000
"""Of a larger cloud every k-th point is looked at."""
_FIT_CELL, _FIT_CELLS = 0.02, 100
"""The table is seen in so many cells without anything high [m]; in fewer, the pose is taken as it is configured."""


def levelled(points: NDArray, camera: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The cloud with heights above the table as seen, and how high each point is no table.

    A hand-eye error of one degree puts the table's far end 7 mm up, and noise grows with the square of the distance:
    both would pass for things that lie there.

    Args:
        points: (N, 3) in the frame *table*, right within 25 mm [m].
        camera: (3,) its position there [m].

    Returns:
        The cloud (N, 3), and (N,) at least `OBJECT_HEIGHT` [m].
    """
    cloud = np.asarray(points, dtype=np.float32)
    least = np.full(len(cloud), OBJECT_HEIGHT, dtype=np.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        return cloud, least
    thin = cloud[:: -(-len(cloud) // _FIT_POINTS) or 1]
    thin = thin[finite_rows(thin)]
    cell = squares(thin[:, :2], _FIT_CELL)
    bare = np.bincount(cell, weights=np.abs(thin[:, 2]) > _NEAR_TABLE) == 0
    if bare.sum() < _FIT_CELLS:
        return cloud, least
    low = thin[bare[cell]]
    above = np.array([0.0, 0.0, 1.0])  # the fit wants its origin above the plane
    plane = fit_plane(low.astype(np.float64) - above, TablePlane(above, 1.0, 0.0, 0.0))

    def far(points: NDArray[np.float32]) -> NDArray[np.float32]:
        x, y, z = (place - at for place, at in zip(points.T, camera.astype(np.float32), strict=True))
        return np.maximum(x * x + y * y + z * z, np.float32(1.0))

    seen = cloud.copy()
    seen[:, 2] = cloud @ plane.normal.astype(np.float32) + np.float32(plane.height - plane.normal[2])
    roughness = 1.48 * float(np.median(np.abs(plane.heights(low - above)) / far(low)))
    return seen, np.maximum(least, _ROUGH * roughness * far(cloud))


def prepare_rows(
    points: NDArray,
    rng: np.random.Generator,
    settings: CloudSettings,
    object_height: float | NDArray = OBJECT_HEIGHT,
) -> NDArray[np.int64]:
    """Rows of a cloud that the network gets, in ascending order.

    Args:
        points: (N, 3) in the frame *table* (z = 0 is the table top) [m]; single NaN points are skipped.
        rng: draws the sample where there are too many.
        settings: limits.
        object_height: what is lower is table, for all points or (N,) [m].

    Raises:
        DgsError: CLOUD_FORMAT (shape), CLOUD_EMPTY, CLOUD_NOT_FINITE (every point is NaN or infinite), NO_OBJECTS.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud has shape {points.shape}, it must be (N, 3)")
    if len(points) == 0:
        raise DgsError(
            ErrorCode.CLOUD_EMPTY, "the cloud has no points: check the camera and the workspace crop"
        )
    # Column by column: numpy reduces over an axis of length three ten times more slowly.
    x, y, z = points.T
    finite = np.isfinite(x) & np.isfinite(y) & np.isfinite(z)
    if not finite.any():
        raise DgsError(
            ErrorCode.CLOUD_NOT_FINITE,
            f"none of the cloud's {len(points)} points is finite: check the depth source",
        )
    rows = np.flatnonzero(finite & (z > settings.lowest))
    near, sure = np.zeros(0, bool), 0
    if len(rows):
        near, sure = _near_objects(x[rows], y[rows], (z > object_height)[rows], settings)
    if sure < settings.min_object_points:
        raise DgsError(
            ErrorCode.NO_OBJECTS,
            f"{sure} points that are no noise stand more than {OBJECT_HEIGHT * 1e3:.0f} mm above the table, "
            f"{settings.min_object_points} are needed: the table is empty or its height is set wrongly",
        )
    if not settings.keep_table:
        rows = rows[near]
    if len(rows) > settings.max_points:
        rows = np.sort(rng.choice(rows, settings.max_points, replace=False))
    return rows


def _near_objects(
    x: NDArray, y: NDArray, high: NDArray[np.bool_], settings: CloudSettings
) -> tuple[NDArray[np.bool_], int]:
    """Which points, at (N,) x and y, lie near those that are `high`, by dilation on a horizontal grid.

    Also how many of those are surely points of an object.
    """
    reach = int(np.ceil(settings.table_margin / settings.cell))
    row, column = (np.floor(values / settings.cell).astype(np.int64) for values in (x, y))
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
    counts = object_points >= settings.cell_points
    seeds = np.flatnonzero(counts)
    step = np.arange(-reach, reach + 1)
    dx, dy = (axis.ravel() for axis in np.meshgrid(step, step, indexing="ij"))
    disc = dx * dx + dy * dy <= reach * reach
    near = np.zeros(cells, dtype=bool)
    near[(seeds[:, None] + (dx * width + dy)[disc]).ravel()] = True
    sure = int(object_points[counts & (2 * object_points > np.bincount(flat, minlength=cells))].sum())
    return near[flat], sure

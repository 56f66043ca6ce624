"""Whether the observed table lies where the camera's configured pose puts it: tilt and height error. No ROS.

The cloud has been brought to `base_link` with the configured pose, so a table that is tilted or too high there means
that the pose is wrong (or that the table was moved). The fit has two steps: least absolute deviations through the low
points of every grid cell, which objects on the table do not pull up; then least squares through all points near that
plane, reweighted with Tukey's biweight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import CELL, Cell

Array = NDArray[np.float64]

_GRID = 0.04
"""Edge of a grid cell [m]."""
_LEAST_POINTS = 8
"""A cell with fewer points says nothing."""
_MOST_POINTS = 20_000
"""Of a larger cloud every k-th point is looked at."""
_LOW = 25.0
"""Percentile of a cell's heights that stands for the table below objects."""
_NEAR = 0.008
"""A point this near to the plane may be the table's [m]."""
_LEAST_SEEN, _LEAST_SHARE = 0.2, 0.3
"""Least part of the workspace in which the table must be seen, and of the points that must be its."""


@dataclass(frozen=True)
class TableBounds:
    """What is still right: tilt [rad], error of the height [m]."""

    tilt: float = 0.02
    height: float = 0.01


@dataclass(frozen=True)
class TableFit:
    """The observed table in `base_link`.

    Attributes:
        tilt: angle between its normal and the vertical [rad].
        direction: where it falls, from the x axis of `base_link` [rad].
        height: how much higher than configured it is in the workspace's middle [m].
        rms: root mean square distance of its points from the plane [m].
        seen: share of the workspace in which it was seen.
    """

    tilt: float
    direction: float
    height: float
    rms: float
    seen: float

    def __str__(self) -> str:
        """Figures in degrees and millimetres."""
        return (
            f"table tilted by {np.rad2deg(self.tilt):.2f} deg (falling towards {np.rad2deg(self.direction):.0f} deg), "
            f"{1e3 * self.height:+.1f} mm off in height, rms {1e3 * self.rms:.1f} mm, seen in {self.seen:.0%} of the "
            "workspace"
        )

    def check(self, bounds: TableBounds) -> None:
        """Compare with bounds.

        Raises:
            DgsError: EXTRINSICS_OFF.
        """
        if self.tilt > bounds.tilt or abs(self.height) > bounds.height:
            raise DgsError(
                ErrorCode.EXTRINSICS_OFF,
                f"{self}; allowed are {np.rad2deg(bounds.tilt):.2f} deg and {1e3 * bounds.height:.0f} mm: calibrate "
                "the camera again, or correct the table's height",
            )


def fit_table(points: ArrayLike, cell: Cell = CELL) -> TableFit:
    """Fit the table in a cloud.

    Args:
        points: (N, 3) in `base_link` [m], without the robot's own; rows that are not finite are skipped.
        cell: where the table should be.

    Raises:
        DgsError: EXTRINSICS_OFF: no table near the configured one is seen.
    """
    cloud = np.asarray(points, float).reshape(-1, 3)
    cloud = cloud[np.isfinite(cloud).all(1)]
    centre, size = np.array(cell.workspace_centre), np.array(cell.workspace_size)
    cloud = cloud[(np.abs(cloud[:, :2] - centre) <= size / 2).all(1)]
    cloud = cloud[:: -(-len(cloud) // _MOST_POINTS) or 1]
    # About the middle of the configured table: x, y, height above it.
    local = cloud - (*centre, cell.table_height)
    low = _low_points(local)
    if len(low) * _GRID**2 < _LEAST_SEEN * size.prod():
        raise _no_table(f"the cloud covers {len(low) * _GRID**2 / size.prod():.0%} of the workspace")
    plane = _least_absolute(low)
    near = np.abs(_distances(low, plane)) < _NEAR
    seen = float(near.sum() * _GRID**2 / size.prod())
    share = float((np.abs(_distances(local, plane)) < _NEAR).mean())
    if seen < _LEAST_SEEN or share < _LEAST_SHARE:
        raise _no_table(
            f"a plane with {share:.0%} of the points, in {seen:.0%} of the workspace, is the best"
        )
    plane, rms = _refined(local, plane)
    a, b, c = plane
    return TableFit(
        tilt=float(np.arctan(np.hypot(a, b))),
        direction=float(np.arctan2(-b, -a)),
        height=float(c),
        rms=rms,
        seen=seen,
    )


def _low_points(local: Array) -> Array:
    """(C, 3) middle and low height of every grid cell that holds enough points."""
    if not len(local):
        return np.zeros((0, 3))
    index = np.floor(local[:, :2] / _GRID).astype(np.int64)
    index -= index.min(0)
    key = index[:, 0] * (index[:, 1].max() + 1) + index[:, 1]
    order = np.lexsort((local[:, 2], key))
    _, first, count = np.unique(key[order], return_index=True, return_counts=True)
    enough = count >= _LEAST_POINTS
    sums = np.add.reduceat(local[order, :2], first)
    middle = (sums / count[:, None])[enough]
    rank = first + (count * _LOW / 100.0).astype(np.int64)
    return np.column_stack([middle, local[order, 2][rank[enough]]])


def _distances(points: Array, plane: Array) -> Array:
    return np.asarray(points[:, 2] - points[:, :2] @ plane[:2] - plane[2])


def _least_absolute(points: Array, rounds: int = 40) -> Array:
    """(3,) a, b, c of z = a x + b y + c with the least sum of absolute deviations, by reweighted least squares."""
    plane = np.array([0.0, 0.0, np.median(points[:, 2])])
    for _ in range(rounds):
        plane = _weighted(points, 1.0 / np.maximum(np.abs(_distances(points, plane)), 5e-4))
    return plane


def _refined(points: Array, plane: Array, rounds: int = 8) -> tuple[Array, float]:
    """The plane through all points near it, and their rms distance [m]."""
    for _ in range(rounds):
        ratio = _distances(points, plane) / _NEAR
        plane = _weighted(points, np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0))
    distance = _distances(points, plane)
    return plane, float(np.sqrt(np.mean(distance[np.abs(distance) < _NEAR] ** 2)))


def _weighted(points: Array, weights: Array) -> Array:
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    normal = (design * weights[:, None]).T
    return np.asarray(np.linalg.solve(normal @ design, normal @ points[:, 2]), dtype=np.float64)


def _no_table(why: str) -> DgsError:
    return DgsError(
        ErrorCode.EXTRINSICS_OFF,
        f"no table where it should be: {why}; the camera's pose is off by more than the cropped workspace shows, the "
        "camera does not see the table, or the table is covered",
    )

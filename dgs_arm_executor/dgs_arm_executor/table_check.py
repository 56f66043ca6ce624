"""Whether the observed table lies where the camera's configured pose puts it: tilt and height error. No ROS.

The cloud has been brought to `base_link` with the configured pose, so a table that is tilted or too high there means
that the pose is wrong (or that the table was moved). The fit begins with the low points of every grid cell, which
objects on the table do not pull up, and ends with all points near that plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.table_fit import TablePlane, fit_plane

MAX_TILT, MAX_HEIGHT = 0.02, 0.01
"""What is still right: tilt [rad], error of the height [m]."""
_GRID = 0.04
"""Edge of a grid cell [m]."""
_LEAST_POINTS = 8
"""A cell with fewer points says nothing."""
_MOST_POINTS = 20_000
"""Of a larger cloud every k-th point is looked at."""
_LOW = 0.25
"""Quantile of a cell's heights that stands for the table below objects."""
_CAPTURE = 0.03
"""Low points this near to a plane decide where the fit begins: more than a table that is seen can be off [m]."""
_LEAST_SEEN, _LEAST_SHARE = 0.2, 0.3
"""Least part of the workspace in which the table must be seen, and of the points that must be its."""
_LIFT = 1.0
"""The fit's origin lies so far above the configured table [m]."""


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

    def check(self, tilt: float = MAX_TILT, height: float = MAX_HEIGHT) -> None:
        """Raise DgsError EXTRINSICS_OFF if it is tilted by more [rad], or farther off in height [m]."""
        if self.tilt > tilt or abs(self.height) > height:
            allowed = f"allowed are {np.rad2deg(tilt):.2f} deg and {1e3 * height:.0f} mm"
            cure = "calibrate the camera again, or correct the table's height"
            raise DgsError(ErrorCode.EXTRINSICS_OFF, f"{self}; {allowed}: {cure}")


def fit_table(points: ArrayLike) -> TableFit:
    """Fit the table in a cloud.

    Args:
        points: (N, 3) in `base_link` [m], without the robot's own; rows that are not finite are skipped.

    Raises:
        DgsError: EXTRINSICS_OFF: no table near the configured one is seen.
    """
    size = np.array(CELL.workspace_size)
    local = np.asarray(points, float).reshape(-1, 3) - CELL.T_base_table[:3, 3]
    local = local[np.isfinite(local).all(1) & (np.abs(local[:, :2]) <= size / 2).all(1)]
    local = local[:: -(-len(local) // _MOST_POINTS) or 1] - (0.0, 0.0, _LIFT)
    low = _low_points(local)
    whole = len(low) * _GRID**2 / size.prod()
    if whole < _LEAST_SEEN:
        raise _no_table(f"the cloud covers {whole:.0%} of the workspace")
    start = TablePlane(np.array([0.0, 0.0, 1.0]), -float(np.median(low[:, 2])), 0.0, 0.0)
    begin = fit_plane(low, start, _CAPTURE)
    seen = whole * float((np.abs(begin.heights(low)) < OBJECT_HEIGHT).mean())
    plane = fit_plane(local, begin)
    if seen < _LEAST_SEEN or plane.share < _LEAST_SHARE:
        best = f"a plane with {plane.share:.0%} of the points, in {seen:.0%} of the workspace"
        raise _no_table(f"{best}, is the best")
    x, y, z = plane.normal
    return TableFit(
        tilt=float(np.arctan2(np.hypot(x, y), z)),
        direction=float(np.arctan2(y, x)),
        height=float(_LIFT - plane.height / z),
        rms=plane.rms,
        seen=seen,
    )


def _low_points(local: Array) -> Array:
    """(C, 3) middle and low height of every grid cell about the middle of the workspace that holds enough points."""
    cell = np.floor(local[:, :2] / _GRID)
    number = cell @ (1e3, 1.0)
    order = np.lexsort((local[:, 2], number))
    _, first, count = np.unique(number[order], return_index=True, return_counts=True)
    low = local[order[first + (_LOW * count).astype(int)], 2]
    return np.c_[(cell[order[first]] + 0.5) * _GRID, low][count >= _LEAST_POINTS]


def _no_table(why: str) -> DgsError:
    off = "the camera's pose is off by more than the cropped workspace shows"
    hidden = "the camera does not see the table, or the table is covered"
    return DgsError(ErrorCode.EXTRINSICS_OFF, f"no table where it should be: {why}; {off}, {hidden}")

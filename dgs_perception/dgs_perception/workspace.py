"""Cuts a cloud down to the workspace in `base_link`: invalid points out, crop, optional voxel filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import CELL
from dgs_description.cloud import voxel_means
from dgs_description.frames import Array


@dataclass(frozen=True)
class CropCounts:
    """What became of the points of one cloud; received = not_finite + zero + outside + merged + kept."""

    received: int
    not_finite: int
    """NaN or infinite."""
    zero: int
    """Exactly (0, 0, 0): not measured, or taken out as a flying pixel."""
    outside: int
    """Not in the workspace box."""
    merged: int
    """Joined with others by the voxel filter."""
    kept: int


Cropped = tuple[NDArray[np.float32], CropCounts]
Corner = tuple[float, float, float]
LOWER, UPPER = (tuple(corner.round(9).tolist()) for corner in CELL.cloud_bounds)
"""Corners of what is looked at in the cell, in `base_link` [m]."""


@dataclass(frozen=True)
class Workspace:
    """The box that is kept, borders included.

    Attributes:
        lower, upper: corners in `base_link` [m]; those of the cell by default.
        voxel_size: edge of the voxels whose points are averaged [m]; 0 keeps every point.

    Raises:
        ValueError: a corner or the voxel size is not finite, a lower limit is not below its upper one, or the voxel
            size is negative.
    """

    lower: Corner = LOWER
    upper: Corner = UPPER
    voxel_size: float = 0.0

    def __post_init__(self) -> None:
        three = len(self.lower) == len(self.upper) == 3
        corners = np.array([self.lower, self.upper], float) if three else np.zeros((2, 3))
        if not np.isfinite(corners).all() or not (corners[0] < corners[1]).all():
            box = f"{self.lower} to {self.upper}"
            raise ValueError(f"The workspace must be lower < upper in x, y, z, not {box} [m].")
        if not (np.isfinite(self.voxel_size) and self.voxel_size >= 0):
            raise ValueError(f"The voxel size must be 0 (off) or a length [m], not {self.voxel_size}.")

    def crop(self, points: NDArray[np.floating], T_base_cloud: Array) -> Cropped:
        """The points inside the box, in `base_link`.

        Args:
            points: (N, 3) in the cloud's frame [m]; may hold NaN, infinities and (0, 0, 0) for "no measurement".
            T_base_cloud: (4, 4) pose of the cloud's frame in `base_link`.

        Returns:
            (M, 3) float32 [m], C order, and the counts. Without the voxel filter the points keep their order; with it
            they are sorted by x, y, z, so that the same cloud always gives the same array.
        """
        planes = np.ascontiguousarray(np.asarray(points, np.float32).T)
        with np.errstate(invalid="ignore", over="ignore"):
            measured = (planes[2] != 0) | (planes[1] != 0) | (planes[0] != 0)
            finite = np.isfinite(planes[0] + planes[1] + planes[2])
            base = T_base_cloud[:3, :3].astype(np.float32) @ planes
            inside = measured & finite
            for axis in range(3):
                base[axis] += np.float32(T_base_cloud[axis, 3])
                inside &= base[axis] >= self.lower[axis]
                inside &= base[axis] <= self.upper[axis]
        kept = np.ascontiguousarray(base[:, inside].T)
        cropped = len(kept)
        if self.voxel_size > 0 and cropped:
            kept = voxel_means(kept, self.voxel_size).astype(np.float32)
        received = planes.shape[1]
        not_finite = received - int(np.count_nonzero(finite))
        zero = received - int(np.count_nonzero(measured))
        outside = received - not_finite - zero - cropped
        return kept, CropCounts(received, not_finite, zero, outside, cropped - len(kept), len(kept))

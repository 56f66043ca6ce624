"""Cuts a cloud down to a box in `base_link`; invalid points are taken out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array


@dataclass(frozen=True)
class CropCounts:
    """What became of the points of one cloud; received = not_finite + zero + outside + kept."""

    received: int
    not_finite: int
    """NaN or infinite."""
    zero: int
    """Exactly (0, 0, 0): not measured, or taken out as a flying pixel."""
    outside: int
    """Not in the box."""
    kept: int


Cropped = tuple[NDArray[np.float32], CropCounts]


def crop(points: NDArray[np.floating], T_base_cloud: Array, lower: Array, upper: Array) -> Cropped:
    """The points inside a box, its borders included, in `base_link`.

    Args:
        points: (N, 3) in the cloud's frame [m]; may hold NaN, infinities and (0, 0, 0) for "no measurement".
        T_base_cloud: (4, 4) pose of the cloud's frame in `base_link`.
        lower, upper: (3,) corners of the box in `base_link` [m].

    Returns:
        (M, 3) float32 [m], C order, in the order of the points, and the counts.
    """
    planes = np.ascontiguousarray(np.asarray(points, np.float32).T)
    with np.errstate(invalid="ignore", over="ignore"):
        measured = (planes[2] != 0) | (planes[1] != 0) | (planes[0] != 0)
        finite = np.isfinite(planes[0] + planes[1] + planes[2])
        base = T_base_cloud[:3, :3].astype(np.float32) @ planes
        inside = measured & finite
        for axis in range(3):
            base[axis] += np.float32(T_base_cloud[axis, 3])
            inside &= (base[axis] >= lower[axis]) & (base[axis] <= upper[axis])
    kept = np.ascontiguousarray(base[:, inside].T)
    received = planes.shape[1]
    not_finite = received - int(np.count_nonzero(finite))
    zero = received - int(np.count_nonzero(measured))
    return kept, CropCounts(received, not_finite, zero, received - not_finite - zero - len(kept), len(kept))

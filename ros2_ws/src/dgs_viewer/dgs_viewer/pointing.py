"""From a click or a rectangle on the screen to the points of an object and the box around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from dgs_description.cell import CELL
from dgs_description.cloud import connected
from dgs_description.frames import OBJECT_HEIGHT, Array

MARGIN = 0.01
"""The box reaches so far beyond the points [m]."""
GAP = 0.012
"""Points that are nearer to one another than this belong to one object [m]."""
AIM = 0.012
"""A click hits the points that are so near to its ray [m]."""

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Box:
    """An upright box in `base_link`: lower and upper corner (3,) [m]."""

    low: Array
    high: Array

    @property
    def centre(self) -> Array:
        """(3,) [m]."""
        return (self.low + self.high) / 2

    @property
    def size(self) -> Array:
        """(3,) edge lengths [m]."""
        return self.high - self.low


@dataclass(frozen=True)
class ScreenCamera:
    """The camera of a browser: position (3,) [m], quaternion wxyz (x right, y down, z forward), vertical field of view
    [rad], width / height."""

    position: ArrayLike
    wxyz: ArrayLike
    fov: float
    aspect: float

    def project(self, points: Array) -> tuple[Array, Mask]:
        """(N, 2) places on the screen (0, 0 upper left to 1, 1), and (N,) which of the points are before the camera."""
        turn = Rotation.from_quat(np.asarray(self.wxyz, np.float64), scalar_first=True)
        local = turn.inv().apply(np.asarray(points, np.float64) - np.asarray(self.position, np.float64))
        ahead = local[:, 2] > 1e-3
        scale = 2 * np.tan(self.fov / 2) * np.array([self.aspect, 1.0])
        depth = np.where(ahead, local[:, 2], 1.0)[:, None]
        return local[:, :2] / depth / scale + 0.5, ahead


def above_table(points: Array) -> Mask:
    """(N,) which of the points (N, 3) in `base_link` are parts of objects."""
    return np.asarray(points[:, 2] > CELL.table_height + OBJECT_HEIGHT)


def hit(points: Array, origin: ArrayLike, direction: ArrayLike) -> int | None:
    """Index of the object point (N, 3) that a ray from `origin` (3,) along `direction` (3,) meets first [m]."""
    start, along = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    along = along / np.linalg.norm(along)
    away = points - start
    distance = away @ along
    beside = np.linalg.norm(away - distance[:, None] * along, axis=1)
    met = np.flatnonzero((beside < AIM) & (distance > 0) & above_table(points))
    if len(met) == 0:
        return None
    # Among the foremost, the one in the middle of the ray.
    front = met[distance[met] < distance[met].min() + 2 * AIM]
    return int(front[np.argmin(beside[front])])


def object_at(points: Array, index: int) -> Mask:
    """(N,) which of the points (N, 3) [m] belong to the same object as one of them; things that touch are one."""
    high = np.flatnonzero(above_table(points))
    labels = connected(points[high], GAP)
    mask = np.zeros(len(points), bool)
    mask[high] = labels == labels[np.searchsorted(high, index)]
    return mask


def in_rectangle(points: Array, camera: ScreenCamera, low: ArrayLike, high: ArrayLike) -> Mask:
    """(N,) which object points (N, 3) [m] lie in a rectangle of the screen, its corners (2,) in 0 to 1."""
    place, ahead = camera.project(points)
    inside = ((place >= np.asarray(low)) & (place <= np.asarray(high))).all(axis=1)
    return inside & ahead & above_table(points)


def box_around(points: Array) -> Box:
    """The box around (N, 3) points, with a margin, down to the table [m]."""
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    low[2] = CELL.table_height - MARGIN
    return Box(low, high)

"""Finds the table in a cloud from an unknown camera: RANSAC for the plane, robust least squares for its exact place.

The method, in the camera's optical frame:
1. The cloud is thinned to one mean point per cube of 1 cm, so that every part of a surface counts by its area and not
   by how near it is to the camera.
2. RANSAC (Fischler and Bolles, 1981) draws planes one after the other until what is left holds none.
3. Planes parallel to the largest one are sorted by height. What lies more than a storey below is the floor, what lies
   less than a storey above a large plane is the top of an object.
4. Least squares with a loss that levels off: object points near the table pull the less the farther off they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array, transform

THINNING = 0.01
"""Edge of the cubes that the cloud is thinned to [m]."""
MAX_DISTANCE = 2.5
"""Points farther from the camera are not looked at [m]."""
MIN_POINTS = 300
"""Thinned points that a cloud must have."""
MIN_SHARE = 0.08
"""Share of the thinned cloud that the table must make up; walls and floor take the rest."""
HYPOTHESES = 400
"""Planes that RANSAC draws: one of 400 lies in a plane of 16 % of the points with a probability of 80 %."""
MAX_PLANES = 6
"""Planes that are looked for: table, floor, walls, tops of large boxes."""
STOREY = 0.35
"""Parallel planes farther apart than this are table and floor, nearer ones table and the tops of objects [m]."""
PARALLEL = float(np.deg2rad(8.0))
"""Planes that enclose less are parallel [rad]."""
MIN_HEIGHT = 0.15
"""The camera is at least so high above the table [m]."""
UP = np.array([0.0, -1.0, -1.0]) / np.sqrt(2.0)
"""Half way between up in the image and towards the camera; see `MAX_LEAN`."""
MAX_LEAN = float(np.deg2rad(60.0))
"""The table's normal lies so near to `UP` [rad].

This tells a table from a wall. It holds for every camera that looks down at 0 to 90 degrees and is rolled by less
than about 45 degrees; turn the image first if yours hangs upside down.
"""
MIN_CONTRAST = 1.5
"""Points on the plane per point just above and below it: a slice through a heap of objects is no plane."""
TALLEST = 0.30
"""Points between `OBJECT_HEIGHT` and this above the table are objects; the frame *table* is put under them [m]."""


@dataclass(frozen=True)
class TablePlane:
    """A plane n . p + h = 0 in the camera's optical frame.

    Attributes:
        normal: (3,) unit vector that points up, to the side on which the camera is.
        height: of the camera above the plane [m].
        share: of the thinned cloud that lies on it.
        rms: root mean square distance of those points [m].
    """

    normal: Array
    height: float
    share: float
    rms: float

    def heights(self, points: NDArray) -> Array:
        """(N,) heights above the table of (N, 3) points [m]."""
        return np.asarray(points @ self.normal + self.height, dtype=np.float64)


def estimate_table(points: NDArray, rng: np.random.Generator) -> TablePlane:
    """The table that a cloud shows.

    Args:
        points: (N, 3) in the camera's optical frame [m]; points that are not finite or at the camera are skipped.
        rng: draws the hypotheses.

    Raises:
        DgsError: CLOUD_FORMAT (shape), CLOUD_EMPTY (too few points within reach), CLOUD_NO_TABLE.
    """
    thin, level = _thinned(points), np.cos(MAX_LEAN)
    planes = [p for p in _planes(thin, rng) if p.normal @ UP > level and p.height >= MIN_HEIGHT]
    if not planes:
        flat = "no plane below the camera that is not steep like a wall"
        raise _no_table(f"{flat} holds {MIN_SHARE:.0%} of the points")
    table = fit_plane(thin, _table_among(planes), _tolerances(thin))
    if table.share < MIN_SHARE:
        raise _no_table(f"the best plane holds {table.share:.0%} of the points")
    distance = np.abs(table.heights(thin)) / _tolerances(thin)
    if (distance < 1).sum() < MIN_CONTRAST * ((distance > 1) & (distance < 3)).sum():
        raise _no_table("the points of the best plane do not stand out from those above and below it")
    return table


def fit_plane(points: NDArray, start: TablePlane, tolerance: Array | float = OBJECT_HEIGHT) -> TablePlane:
    """The plane near `start` that fits the points best, whatever lies farther off.

    Unknown is m = n / h, with which m . p + 1 = 0.

    Args:
        points: (N, 3) finite, in a frame whose origin lies above the plane [m].
        start: normal and height to begin with; what is near to it at first decides.
        tolerance: scalar or (N,), how near to the plane its points lie [m].
    """

    def distances(m: Array) -> Array:
        return (points @ m + 1.0) / (np.linalg.norm(m) * tolerance)

    m = least_squares(distances, start.normal / max(start.height, 1e-3), loss="arctan", f_scale=0.4).x
    height = 1.0 / float(np.linalg.norm(m))
    distance = points @ (m * height) + height
    near = np.abs(distance) < tolerance
    rms = float(np.sqrt((distance[near] ** 2).sum() / max(near.sum(), 1)))
    return TablePlane(m * height, height, float(near.sum() / max(len(points), 1)), rms)


def table_frame(plane: TablePlane, points: NDArray) -> Array:
    """T_camera_table, (4, 4): a frame *table* for the planner, where no extrinsics say where the workspace is.

    The origin lies on the table under the middle (median) of the objects; z points up, x level towards the camera.

    Args:
        plane: of `estimate_table`.
        points: (N, 3) in the camera's optical frame [m].
    """
    finite = np.asarray(points, np.float64)[np.isfinite(points).all(axis=1)]
    height = plane.heights(finite)
    level = np.abs(height) < THINNING
    z = plane.normal
    towards_camera = -_in_plane(finite[level].mean(axis=0), z)
    if np.linalg.norm(towards_camera) < 1e-3 * plane.height:  # from straight above: the image's lower edge
        towards_camera = _in_plane(np.array([0.0, 1.0, 0.0]), z)
    x = towards_camera / np.linalg.norm(towards_camera)
    T_camera_table = transform(np.column_stack([x, np.cross(z, x), z]), -plane.height * z)
    local = (finite @ T_camera_table[:3, :3])[:, :2]
    low, high = np.percentile(local[level], (2, 98), axis=0)
    seen = ((local > low) & (local < high)).all(axis=1)
    objects = local[seen & (height > OBJECT_HEIGHT) & (height < TALLEST)]
    middle = np.median(objects if len(objects) else local[level], axis=0)
    T_camera_table[:3, 3] += T_camera_table[:3, :2] @ middle
    return T_camera_table


def voxel_means(points: NDArray, edge: float, least: int = 1) -> Array:
    """(M, 3) mean of the points (N, 3) of every occupied cube, cubes in ascending order of x, then y, then z [m].

    Args:
        points: finite.
        edge: of the cubes, which have a corner in the frame's origin [m].
        least: cubes with fewer points are left out.
    """
    if not len(points):
        return np.zeros((0, 3))
    cube = np.floor(points / edge).astype(np.int64)
    cube -= cube.min(axis=0)
    number = np.ravel_multi_index(tuple(cube.T), tuple(cube.max(axis=0) + 1))
    _, place, count = np.unique(number, return_inverse=True, return_counts=True)
    sums = [np.bincount(place, weights=points[:, k], minlength=len(count)) for k in range(3)]
    return (np.stack(sums, axis=1) / count[:, None])[count >= least]


def _no_table(why: str) -> DgsError:
    cure = "show more of the table or give the camera's extrinsics"
    return DgsError(ErrorCode.CLOUD_NO_TABLE, f"no table found: {why}; {cure}")


def _in_plane(vector: Array, normal: Array) -> Array:
    return vector - (vector @ normal) * normal


def _thinned(points: NDArray) -> Array:
    """One mean point per occupied cube."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud has shape {points.shape}, it must be (N, 3)")
    values = np.asarray(points, np.float64)[np.isfinite(points).all(axis=1)]
    distance = np.linalg.norm(values, axis=1)
    values = voxel_means(values[(distance > 1e-6) & (distance < MAX_DISTANCE)], THINNING)
    if len(values) < MIN_POINTS:
        raise DgsError(
            ErrorCode.CLOUD_EMPTY,
            f"the cloud covers {len(values)} cubes of {THINNING * 1e3:.0f} mm within {MAX_DISTANCE:g} m of the camera, "
            f"{MIN_POINTS} are needed: is its unit metres?",
        )
    return values


def _tolerances(points: Array) -> Array:
    """(N,) how near to a plane a point belongs to it [m]; beyond 1 m the depth error grows with the square."""
    return np.asarray(OBJECT_HEIGHT * np.maximum(np.linalg.norm(points, axis=1), 1.0) ** 2)


def _planes(points: Array, rng: np.random.Generator) -> list[TablePlane]:
    """Planes with at least the wanted share, in the order they were found: the largest first, walls included."""
    found: list[TablePlane] = []
    rest = points
    while len(rest) > MIN_SHARE * len(points) and len(found) < MAX_PLANES:
        plane = _drawn(rest, rng)
        if plane is None:
            break
        plane = fit_plane(rest, plane, _tolerances(rest))
        share = plane.share * len(rest) / len(points)
        if share < MIN_SHARE:
            break
        found.append(TablePlane(plane.normal, plane.height, share, plane.rms))
        rest = rest[np.abs(plane.heights(rest)) > 2 * _tolerances(rest)]
    return found


def _drawn(points: Array, rng: np.random.Generator) -> TablePlane | None:
    """RANSAC: the plane through three points that most points lie near to."""
    sample = points[rng.choice(len(points), min(len(points), 2000), replace=False)]
    a, b, c = sample[rng.integers(0, len(sample), (3, HYPOTHESES))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    # Three points that almost stand in line give a direction of noise.
    usable = length > 25 * THINNING**2
    if not usable.any():
        return None
    normals = normals[usable] / length[usable, None]
    heights = -np.einsum("ki,ki->k", normals, a[usable])
    near = np.abs(normals @ sample.T + heights[:, None]) < _tolerances(sample)
    best = int(near.sum(axis=1).argmax())
    sign = 1.0 if heights[best] >= 0 else -1.0
    return TablePlane(sign * normals[best], float(sign * heights[best]), 0.0, 0.0)


def _table_among(planes: list[TablePlane]) -> TablePlane:
    """The table among parallel planes: the lowest large one of the uppermost storey."""
    largest = max(planes, key=lambda plane: plane.share)
    level = [plane for plane in planes if plane.normal @ largest.normal > np.cos(PARALLEL)]
    level.sort(key=lambda plane: plane.height)  # the highest plane is the one least below the camera
    table = level[0]
    for plane in level[1:]:
        if plane.height - table.height > STOREY:
            break
        table = plane
    return table

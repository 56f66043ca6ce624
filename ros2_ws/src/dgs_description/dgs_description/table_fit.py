"""Finds the table in a cloud from an unknown camera: RANSAC for the plane, robust least squares for its exact place.

Numpy only, so that it runs wherever the planner runs. The method, in the camera's optical frame:
1. The cloud is thinned to one mean point per cube of 1 cm, so that every part of a surface counts by its area and not
   by how near it is to the camera.
2. RANSAC (Fischler and Bolles, 1981) draws planes one after the other until what is left holds none.
3. Planes parallel to the largest one are sorted by height. What lies more than a storey below is the floor, what lies
   less than a storey above a large plane is the top of an object.
4. Least squares on the plane's points, repeated with Tukey's biweight: object points near the table pull the less the
   farther off they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import inverse, transform

Array = NDArray[np.float64]

_EXPECTED_NORMAL = np.array([0.0, -1.0, -1.0]) / np.sqrt(2.0)


@dataclass(frozen=True)
class TableSettings:
    """What passes for a table. Lengths in metres."""

    cell: float = 0.01
    """Edge of the cubes that the cloud is thinned to."""
    max_distance: float = 2.5
    """Points farther from the camera are not looked at."""
    tolerance: float = 0.008
    """A point so near to a plane belongs to it, at up to 1 m; beyond, the depth error grows with the square."""
    min_share: float = 0.08
    """Share of the thinned cloud that the table must make up; walls and floor take the rest."""
    min_points: int = 300
    """Thinned points that a cloud must have."""
    hypotheses: int = 400
    """Planes that RANSAC draws."""
    storey: float = 0.35
    """Parallel planes farther apart than this are table and floor, nearer ones table and the tops of objects."""
    parallel: float = float(np.deg2rad(8.0))
    """Planes that enclose less are parallel [rad]."""
    min_height: float = 0.15
    """The camera is at least so high above the table."""
    max_lean: float = float(np.deg2rad(60.0))
    """The table's normal lies so near to the direction half way between up in the image and towards the camera [rad].

    This tells a table from a wall. It holds for every camera that looks down at 0 to 90 degrees and is rolled by less
    than about 45 degrees; turn the image first if yours hangs upside down.
    """
    min_contrast: float = 1.5
    """Points on the plane per point just above and below it: a slice through a heap of objects is no plane."""


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


def estimate_table(
    points: NDArray, rng: np.random.Generator, settings: TableSettings = TableSettings()
) -> TablePlane:
    """The table that a cloud shows.

    Args:
        points: (N, 3) in the camera's optical frame [m]; points that are not finite or at the camera are skipped.
        rng: draws the hypotheses.
        settings: limits.

    Raises:
        DgsError: CLOUD_FORMAT (shape), CLOUD_EMPTY (too few points within reach), CLOUD_NO_TABLE.
    """
    thin = _thinned(points, settings)
    planes = [
        p for p in _planes(thin, rng, settings) if p.normal @ _EXPECTED_NORMAL > np.cos(settings.max_lean)
    ]
    planes = [p for p in planes if p.height >= settings.min_height]
    if not planes:
        raise _no_table(
            f"no plane below the camera that is not steep like a wall holds {settings.min_share:.0%} of the points"
        )
    plane = _refined(thin, _storey_of(planes, settings), settings)
    _check(plane, thin, settings)
    return plane


def table_frame(
    plane: TablePlane, points: NDArray, object_heights: tuple[float, float] = (0.012, 0.30)
) -> Array:
    """T_camera_table, (4, 4): a frame *table* for the planner, where no extrinsics say where the workspace is.

    The origin lies on the table under the middle (median) of the objects; z points up, x level towards the camera.

    Args:
        plane: of `estimate_table`.
        points: (N, 3) in the camera's optical frame [m].
        object_heights: points between them, above the seen part of the table, are objects [m].
    """
    finite = np.asarray(points, np.float64)[np.isfinite(points).all(axis=1)]
    height = plane.heights(finite)
    z = plane.normal
    towards_camera = -_in_plane(finite[np.abs(height) < 0.01].mean(axis=0), z)
    if np.linalg.norm(towards_camera) < 1e-3 * plane.height:
        towards_camera = _in_plane(
            np.array([0.0, 1.0, 0.0]), z
        )  # seen from straight above: image's lower edge
    x = towards_camera / np.linalg.norm(towards_camera)
    T_camera_table = transform(np.column_stack([x, np.cross(z, x), z]), -plane.height * z)
    local = finite @ T_camera_table[:3, :3]
    table = local[np.abs(height) < 0.01, :2]
    low, high = np.percentile(table, (2, 98), axis=0)
    inside = ((local[:, :2] > low) & (local[:, :2] < high)).all(axis=1)
    objects = local[inside & (height > object_heights[0]) & (height < object_heights[1]), :2]
    middle = np.median(objects if len(objects) else table, axis=0)
    T_camera_table[:3, 3] += T_camera_table[:3, :2] @ middle
    return T_camera_table


def _check(plane: TablePlane, points: Array, settings: TableSettings) -> None:
    """Refuse a plane that is too small, or that is a mere slice through something thick."""
    if plane.share < settings.min_share:
        raise _no_table(f"the best plane holds {plane.share:.0%} of the points")
    distance = np.abs(plane.heights(points)) / _tolerances(points, settings)
    if (distance < 1).sum() < settings.min_contrast * ((distance > 1) & (distance < 3)).sum():
        raise _no_table("the points of the best plane do not stand out from those above and below it")


def camera_in_table(T_camera_table: Array) -> Array:
    """(3,) position of the camera in the table frame [m]."""
    return np.asarray(inverse(T_camera_table)[:3, 3])


def _no_table(why: str) -> DgsError:
    return DgsError(
        ErrorCode.CLOUD_NO_TABLE,
        f"no table found: {why}; show more of the table or give the camera's extrinsics",
    )


def _in_plane(vector: Array, normal: Array) -> Array:
    return vector - (vector @ normal) * normal


def _thinned(points: NDArray, settings: TableSettings) -> Array:
    """One mean point per occupied cube."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud has shape {points.shape}, it must be (N, 3)")
    values = np.asarray(points, np.float64)[np.isfinite(points).all(axis=1)]
    distance = np.linalg.norm(values, axis=1)
    values = values[(distance > 1e-6) & (distance < settings.max_distance)]
    if len(values):
        cube = np.floor(values / settings.cell).astype(np.int64)
        cube -= cube.min(axis=0)
        size = cube.max(axis=0) + 1
        key = (cube[:, 0] * size[1] + cube[:, 1]) * size[2] + cube[:, 2]
        _, place, count = np.unique(key, return_inverse=True, return_counts=True)
        sums = [np.bincount(place, weights=values[:, k], minlength=len(count)) for k in range(3)]
        values = np.stack(sums, axis=1) / count[:, None]
    if len(values) < settings.min_points:
        raise DgsError(
            ErrorCode.CLOUD_EMPTY,
            f"the cloud covers {len(values)} cubes of {settings.cell * 1e3:.0f} mm within "
            f"{settings.max_distance:g} m of the camera, {settings.min_points} are needed: is its unit metres?",
        )
    return values


def _tolerances(points: Array, settings: TableSettings) -> Array:
    return np.asarray(settings.tolerance * np.maximum(np.linalg.norm(points, axis=1), 1.0) ** 2)


def _planes(points: Array, rng: np.random.Generator, settings: TableSettings) -> list[TablePlane]:
    """Planes with at least the wanted share, in the order they were found: the largest first, walls included."""
    found: list[TablePlane] = []
    rest = points
    while len(rest) > settings.min_share * len(points) and len(found) < 6:
        plane = _ransac(rest, rng, settings)
        if plane is None:
            break
        plane = _refined(rest, plane, settings, rounds=3)
        distance = np.abs(plane.heights(rest)) / _tolerances(rest, settings)
        share = float((distance < 1).sum() / len(points))
        if share < settings.min_share:
            break
        found.append(TablePlane(plane.normal, plane.height, share, plane.rms))
        rest = rest[distance > 2]
    return found


def _ransac(points: Array, rng: np.random.Generator, settings: TableSettings) -> TablePlane | None:
    """The plane through three points that most points lie near to."""
    sample = points[rng.choice(len(points), min(len(points), 2000), replace=False)]
    a, b, c = sample[rng.integers(0, len(sample), (3, settings.hypotheses))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    # Three points that almost stand in line give a direction of noise.
    usable = length > 25 * settings.cell**2
    if not usable.any():
        return None
    normals, a = normals[usable] / length[usable, None], a[usable]
    heights = -np.einsum("ki,ki->k", normals, a)
    near = np.abs(normals @ sample.T + heights[:, None]) < _tolerances(sample, settings)
    best = int(near.sum(axis=1).argmax())
    sign = 1.0 if heights[best] >= 0 else -1.0
    return TablePlane(sign * normals[best], float(sign * heights[best]), 0.0, 0.0)


def _storey_of(planes: list[TablePlane], settings: TableSettings) -> TablePlane:
    """The table among parallel planes: the lowest large one of the uppermost storey."""
    largest = max(planes, key=lambda p: p.share)
    level = [p for p in planes if p.normal @ largest.normal > np.cos(settings.parallel)]
    level.sort(key=lambda p: p.height)  # the highest plane is the one least below the camera
    table = level[0]
    for plane in level[1:]:
        if plane.height - table.height > settings.storey:
            break
        table = plane
    return table


def _refined(points: Array, plane: TablePlane, settings: TableSettings, rounds: int = 12) -> TablePlane:
    """Total least squares with Tukey's biweight, its width falling from the tolerance to what the noise asks for."""
    tolerance = _tolerances(points, settings)
    width = tolerance
    for _ in range(rounds):
        residual = plane.heights(points)
        weight = np.where(np.abs(residual) < width, (1 - (residual / width) ** 2) ** 2, 0.0)
        middle = weight @ points / weight.sum()
        centred = points - middle
        _, axes = np.linalg.eigh((centred * weight[:, None]).T @ centred)
        normal = axes[:, 0]
        height = -float(normal @ middle)
        plane = TablePlane(normal if height >= 0 else -normal, abs(height), 0.0, 0.0)
        near = np.abs(plane.heights(points)) < width
        deviation = 1.4826 * float(np.median(np.abs(plane.heights(points[near]))))
        width = np.minimum(tolerance, np.maximum(4.7 * deviation, 0.25 * settings.tolerance))
    residual = plane.heights(points)
    near = np.abs(residual) < tolerance
    rms = float(np.sqrt(np.mean(residual[near] ** 2)))
    return TablePlane(plane.normal, plane.height, float(near.mean()), rms)

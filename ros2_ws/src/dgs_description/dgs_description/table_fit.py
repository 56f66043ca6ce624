"""Finds the table in a cloud from an unknown camera: RANSAC for the plane, robust least squares for its exact place.

The method, in the camera's optical frame:
1. The cloud is thinned to one mean point per cube whose edge grows with the distance, 12 mm at 1 m, so that a surface
   seen at a low angle counts as much as one seen from above, and a table close by as much as the floor behind it.
2. RANSAC (Fischler and Bolles, 1981) draws planes one after the other until what is left holds none.
3. Of parallel planes, what lies more than a storey below is the floor, what lies less than a storey above a large plane
   is the top of an object. Of the rest the table is the one on which things stand: nothing stands on a wall or on the
   side of a box. The camera may be rolled by any angle; that it is level decides only where nothing stands anywhere.
4. Least squares with a loss that levels off: object points near the table pull the less the farther off they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from dgs_description.cloud import finite_rows, squares, voxel_means
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array, transform

THINNING = 0.012
"""Edge of the cubes that the cloud is thinned to, per metre of distance."""
MAX_DISTANCE = 2.5
"""Points farther from the camera are not looked at [m]."""
NEAREST = 0.18
"""The middle of the cloud is farther from the camera [m]."""
MIN_POINTS = 300
"""Thinned points that a cloud must have, and a third of it the table."""
MIN_SHARE = 0.03
"""Share of the thinned cloud that the table must make up: of a corner of it above a floor more is not seen."""
HYPOTHESES = 600
"""Planes that RANSAC draws: one of 600 lies in a plane of 15 % of the points with a probability of 87 %."""
SMALLEST_TRIANGLE = 0.0025
"""Twice the area of the triangle that three points make; those that almost stand in line say nothing [m^2]."""
MAX_PLANES = 10
"""Planes that are looked for: table, floor, walls, sides and tops of large boxes."""
STOREY = 0.35
"""Parallel planes farther apart than this are table and floor, nearer ones table and the tops of objects [m]."""
PARALLEL = float(np.deg2rad(8.0))
"""Planes that enclose less are parallel [rad]."""
MIN_HEIGHT = 0.08
"""The camera is at least so high above the table [m]."""
MAX_TILT = float(np.deg2rad(80.0))
"""The camera's axis is tilted by no more from straight down [rad]."""
CARRIED = 0.10
"""Things up to this high above a plane stand on it rather than beside it [m]."""
HIDDEN = 0.05
"""A thing hides the plane that it stands on, but not farther around [m]."""
LARGE = 0.07
"""A plane with so many times another's points is no thing that stands on it."""
AIM = 0.25
"""A camera is aimed at the table: what is so near to its axis counts where nothing stands anywhere [rad]."""
MIN_THINGS = 0.002
"""A smaller share of the thinned cloud says nothing about what it stands on."""
TIE_BREAK = 0.05
"""What the camera's aim, and that the normal points up in the image, count beside the things that stand on a plane."""
MIN_CONTRAST = 2.5
"""Points on the plane per point just above and below it: a slice through a heap of objects is no plane.

Rendered tables had 8 and more, slices through fog, balls and heaps up to 2.1.
"""
CONTRAST_CELL = 0.03
"""Edge of the squares on a plane in which that is looked at [m]."""
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

    Raises:
        DgsError: CLOUD_FORMAT (shape), CLOUD_EMPTY (too few points within reach), CLOUD_NO_TABLE.
    """
    thin = _thinned(points)
    planes = _planes(thin, rng)
    facing = [p for p in planes if -p.normal[2] > np.cos(MAX_TILT) and p.height >= MIN_HEIGHT]
    if not facing:
        raise _no_table(f"no plane below the camera holds {MIN_SHARE:.0%} of the points")
    solid = [p for p in facing if p.share * len(thin) > MIN_POINTS / 3 and _stands_out(p, thin)]
    if not solid:
        raise _no_table("the points of the best plane do not stand out from those above and below it")
    table = fit_plane(thin, _table_among(solid, planes, thin), _tolerances(thin))
    if table.share < MIN_SHARE:
        raise _no_table(f"the best plane holds {table.share:.0%} of the points")
    return table


def draw_plane(
    points: Array, tolerance: Array | float, hypotheses: int, rng: np.random.Generator
) -> tuple[Array, float] | None:
    """RANSAC: the plane n . p + h = 0 through three of the points that most of them lie near to.

    Args:
        points: (N, 3) [m].
        tolerance: scalar or (N,), how near [m].

    Returns:
        (3,) unit n and h [m]; None where all points drawn almost stand in line.
    """
    a, b, c = points[rng.integers(0, len(points), (3, hypotheses))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    usable = length > SMALLEST_TRIANGLE
    if not usable.any():
        return None
    normals = normals[usable] / length[usable, None]
    heights = -np.einsum("ki,ki->k", normals, a[usable])
    best = int(counts_near(normals, heights, points, tolerance).argmax())
    return normals[best], float(heights[best])


def counts_near(
    normals: Array, offsets: Array, points: NDArray, tolerance: Array | float
) -> NDArray[np.int64]:
    """(K,) how many of the points (N, D) lie within a tolerance, scalar or (N,), of each plane n . p + h = 0 [m]."""
    distance = normals.astype(np.float32) @ points.T.astype(np.float32)
    distance += offsets.astype(np.float32)[:, None]
    np.abs(distance, out=distance)
    # Row by row: numpy counts along an axis more slowly.
    return np.array([np.count_nonzero(row) for row in distance < np.float32(tolerance)])


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

    def slopes(m: Array) -> Array:
        length = np.linalg.norm(m)
        return (points - np.outer((points @ m + 1.0) / length**2, m)) / (
            length * np.reshape(tolerance, (-1, 1))
        )

    begin = start.normal / max(start.height, 1e-3)
    m = least_squares(distances, begin, slopes, loss="arctan", f_scale=0.4).x
    height = 1.0 / float(np.linalg.norm(m))
    distance = points @ (m * height) + height
    near = np.abs(distance) < tolerance
    rms = float(np.sqrt((distance[near] ** 2).sum() / max(near.sum(), 1)))
    return TablePlane(m * height, height, float(near.sum() / max(len(points), 1)), rms)


def table_frame(plane: TablePlane, points: NDArray, things: NDArray[np.bool_] | None = None) -> Array:
    """T_camera_table, (4, 4): a frame *table* for the planner, where no extrinsics say where the workspace is.

    The origin lies on the table under the middle (median) of the objects; z points up, x level towards the camera.

    Args:
        plane: of `estimate_table`.
        points: (N, 3) in the camera's optical frame [m].
        things: (N,) which points are objects; None = all that stand on what is seen of the table.
    """
    good = finite_rows(points)
    finite = np.asarray(points, np.float64)[good]
    height = plane.heights(finite)
    level = np.abs(height) < OBJECT_HEIGHT
    z = plane.normal
    towards_camera = -_in_plane(finite[level].mean(axis=0), z)
    if np.linalg.norm(towards_camera) < 1e-3 * plane.height:  # from straight above: the image's lower edge
        towards_camera = _in_plane(np.array([0.0, 1.0, 0.0]), z)
    x = towards_camera / np.linalg.norm(towards_camera)
    T_camera_table = transform(np.column_stack([x, np.cross(z, x), z]), -plane.height * z)
    local = (finite @ T_camera_table[:3, :3])[:, :2]
    low, high = np.percentile(local[level], (2, 98), axis=0)
    seen = ((local > low) & (local < high)).all(axis=1) if things is None else things[good]
    objects = local[seen & (height > OBJECT_HEIGHT) & (height < TALLEST)]
    middle = np.median(objects if len(objects) else local[level], axis=0)
    T_camera_table[:3, 3] += T_camera_table[:3, :2] @ middle
    return T_camera_table


def _no_table(why: str) -> DgsError:
    cure = "show more of the table or take the cell's camera (--in-cell)"
    return DgsError(ErrorCode.CLOUD_NO_TABLE, f"no table found: {why}; {cure}")


def _in_plane(vector: Array, normal: Array) -> Array:
    return vector - (vector @ normal) * normal


def _thinned(points: NDArray) -> Array:
    """One mean point per occupied cube."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise DgsError(ErrorCode.CLOUD_FORMAT, f"the cloud has shape {points.shape}, it must be (N, 3)")
    values = np.asarray(points, np.float64)[finite_rows(points)]
    values = values[(values[:, 2] > 1e-3) & (np.linalg.norm(values, axis=1) < MAX_DISTANCE)]
    z = values[:, 2:]
    values = voxel_means(values, THINNING, place=np.hstack([values[:, :2] / z, np.log(z)]))
    if len(values) < MIN_POINTS:
        raise DgsError(
            ErrorCode.CLOUD_EMPTY,
            f"the cloud covers {len(values)} cubes of {THINNING * 1e3:.0f} mm (at 1 m) within {MAX_DISTANCE:g} m of "
            f"the camera, {MIN_POINTS} are needed: is its unit metres?",
        )
    middle = float(np.median(np.linalg.norm(values, axis=1)))
    if middle < NEAREST:
        near = f"half of the cloud is nearer than {middle:.2f} m, a depth camera sees nothing below {NEAREST:g} m"
        raise DgsError(ErrorCode.CLOUD_EMPTY, f"{near}: is its unit metres?")
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
        found.append(replace(plane, share=share))
        rest = rest[np.abs(plane.heights(rest)) > 2 * _tolerances(rest)]
    return found


def _drawn(points: Array, rng: np.random.Generator) -> TablePlane | None:
    sample = points[rng.choice(len(points), min(len(points), 2000), replace=False)]
    found = draw_plane(sample, _tolerances(sample), HYPOTHESES, rng)
    if found is None:
        return None
    normal, height = found
    sign = 1.0 if height >= 0 else -1.0
    return TablePlane(sign * normal, sign * height, 0.0, 0.0)


def _table_among(solid: list[TablePlane], planes: list[TablePlane], points: Array) -> TablePlane:
    """The plane on which things stand: what a wall, a floor or the side of a box does not have."""
    tables = [(plane, upper) for plane in solid for upper in [_upper(plane, solid)] if upper is not None]
    carried = np.array([_carried(plane, planes, points) for plane, _ in tables], float)
    carried[carried < MIN_THINGS * len(points)] = 0.0
    middle = points[np.hypot(points[:, 0], points[:, 1]) < AIM * points[:, 2]]
    aimed = np.array([(np.abs(plane.heights(middle)) < _tolerances(middle)).sum() for plane, _ in tables])
    # y points down in the image
    favoured = np.array([2.0 * upper - plane.normal[1] for plane, upper in tables])
    score = carried / max(carried.max(), 1.0) + TIE_BREAK * (aimed / max(aimed.max(), 1) + favoured)
    return tables[int(score.argmax())][0]


def _upper(plane: TablePlane, planes: list[TablePlane]) -> bool | None:
    """Whether a plane is the uppermost storey of those parallel to it; None where a lower plane is of its storey."""
    level = [other.height for other in planes if other.normal @ plane.normal > np.cos(PARALLEL)]
    if any(0 < height - plane.height < STOREY for height in level):
        return None
    return all(height > plane.height - STOREY for height in level)


def _carried(plane: TablePlane, planes: list[TablePlane], points: Array) -> int:
    """Points of things that stand where a plane is seen; table and walls do not stand on one another."""
    height = plane.heights(points)
    thing = (height > 2 * _tolerances(points)) & (height < CARRIED)
    for other in planes:
        if other.share > LARGE * plane.share and other.normal @ plane.normal < np.cos(PARALLEL):
            thing &= np.abs(other.heights(points)) > 2 * _tolerances(points)
    flat = points @ _axes(plane).T
    beneath, _ = cKDTree(flat[np.abs(height) < _tolerances(points)]).query(
        flat[thing], distance_upper_bound=HIDDEN
    )
    return int(np.isfinite(beneath).sum())


def _axes(plane: TablePlane) -> Array:
    """(2, 3) unit vectors in a plane."""
    return np.asarray(np.linalg.svd(plane.normal[None])[2][1:], np.float64)


def _stands_out(plane: TablePlane, points: Array) -> bool:
    """Where the plane is seen, hardly anything lies just above or below it: a slice through a heap is no table."""
    distance = np.abs(plane.heights(points)) / _tolerances(points)
    cell = squares(points @ _axes(plane).T, CONTRAST_CELL)
    on, beside = (np.bincount(cell, weights=w) for w in (distance < 1, (distance > 1) & (distance < 3)))
    seen = on > 0
    return bool(on[seen].sum() >= MIN_CONTRAST * beside[seen].sum())

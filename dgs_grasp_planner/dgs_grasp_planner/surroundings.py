"""What stands on a table and is no thing to grasp: walls; without a known workspace also what the table does not carry.

Frame *table* throughout. A wall is a vertical plane that is longer than a thing and closed from below to `WALL_HEIGHT`;
what is behind it goes with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, label
from scipy.spatial import ConvexHull, QhullError, cKDTree

from dgs_description.cloud import connected, voxel_means
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array, apply
from dgs_description.table_fit import counts_near

Mask = NDArray[np.bool_]

VOXEL = 0.008
"""Edge of the cells of which things have one point each [m]."""
GAP = 2 * VOXEL
"""Voxels nearer to one another than this belong to one thing [m]."""
WALL_LENGTH, WALL_HEIGHT = 0.30, 0.14
"""What is closed over so much of a vertical plane is no thing: boxes are shorter, rows of bottles have gaps [m]."""
WALL_THICKNESS = 0.025
"""Points so near to a wall's plane are the wall's [m]."""
WALL_CELL = 0.02
"""Edge of the squares on a wall that are looked at [m]."""
WALL_FILLED, WALL_CLOSED = 0.8, 0.9
"""Share of a column's squares, and of the columns, that hold points where a wall is."""
MAX_WALLS = 3
HYPOTHESES = 300
TALL = 0.35
"""A thing is no higher [m]."""
FAR = 10.0
"""What is farther is not on the table [m]."""
LARGE, FOOT = 0.40, 0.03
"""What is longer, or was cut off from something, is a thing, or several, if it is seen as far down as this [m]."""
OVER = 0.015
"""What stands so far outside of the table's outline is not on the table [m]."""
RIM = 0.03
"""What has fewer voxels than `PIECE` and is so near to the outline is noise [m]."""
OVER_SHARE = 0.1
"""A thing with a larger share of it outside is not on the table."""
MIN_VOXELS = 8
"""Fewer voxels are noise."""
PIECE, NEAR = 40, 0.05
"""What has fewer voxels and is so near to something that is no thing is a piece of it; what reaches over the table's
edge is cut off so near to it [m]."""


@dataclass(frozen=True)
class Wall:
    """A vertical plane n . (x, y) = offset, seen where `low` < t . (x, y) < `high` [m].

    Attributes:
        normal: (2,) unit vector away from the camera.
    """

    normal: Array
    offset: float
    low: float
    high: float

    def holds(self, points: NDArray) -> Mask:
        """(N,) which of the points (N, >= 2) [m] are the wall's, or stand behind it."""
        along = points[:, :2] @ (-self.normal[1], self.normal[0])
        beside = (along > self.low - WALL_CELL) & (along < self.high + WALL_CELL)
        return np.asarray(beside & (points[:, :2] @ self.normal > self.offset - WALL_THICKNESS))


def walls(voxels: Array, camera: Array) -> list[Wall]:
    """The walls among voxels (V, 3) of what stands on the table, seen from (3,) `camera` [m]; the largest first."""
    found: list[Wall] = []
    rest = voxels[voxels[:, 2] > 0.01]
    rng = np.random.default_rng(0)
    while len(found) < MAX_WALLS:
        wall = _largest_wall(rest, camera, rng)
        if wall is None:
            break
        found.append(wall)
        rest = rest[~wall.holds(rest)]
    return found


def _largest_wall(voxels: Array, camera: Array, rng: np.random.Generator) -> Wall | None:
    flat = voxels[voxels[:, 2] < WALL_HEIGHT, :2]
    if len(flat) < WALL_LENGTH * WALL_HEIGHT / WALL_CELL**2:
        return None
    a, b = flat[rng.integers(0, len(flat), (2, HYPOTHESES))]
    length = np.linalg.norm(b - a, axis=1)
    far = length > WALL_LENGTH / 2
    if not far.any():
        return None
    along = (b - a)[far] / length[far, None]
    normals = np.column_stack([along[:, 1], -along[:, 0]])
    offsets = np.einsum("ki,ki->k", normals, a[far])
    best = int(counts_near(normals, -offsets, flat, WALL_THICKNESS).argmax())
    normal, offset = normals[best], offsets[best]
    if normal @ camera[:2] > offset:
        normal, offset = -normal, -offset
    on = voxels[np.abs(voxels[:, :2] @ normal - offset) < WALL_THICKNESS]
    place = on[:, :2] @ (-normal[1], normal[0])
    squares = np.unique(np.floor(np.column_stack([place, on[:, 2]]) / WALL_CELL).astype(np.int64), axis=0)
    low = squares[squares[:, 1] < WALL_HEIGHT / WALL_CELL, 0]
    columns, filled = np.unique(low, return_counts=True)
    closed = columns[filled >= WALL_FILLED * WALL_HEIGHT / WALL_CELL]
    if len(closed) * WALL_CELL < WALL_LENGTH:
        return None
    # Things in front hide a wall's foot, not its top; between bottles there is neither.
    seen = np.unique(squares[:, 0])
    if ((seen >= closed[0]) & (seen <= closed[-1])).sum() < WALL_CLOSED * (closed[-1] - closed[0] + 1):
        return None
    return Wall(normal, float(offset), float(place.min()), float(place.max()))


def things_on_table(points: NDArray, T_camera_table: Array) -> Mask:
    """Which points belong to things that stand on the table, where only the table says what can be grasped.

    No thing is what reaches over the table's outline, is taller than `TALL` (a robot, a lamp), hovers and is longer
    than `LARGE` (an arm), or a wall. The outline is the convex hull of what is seen of the table; where it ends because
    the picture ends, nothing is known.

    Args:
        points: (N, 3) all finite points of the camera, frame *table* [m].
        T_camera_table: (4, 4) pose of the frame *table* in the optical frame.

    Raises:
        DgsError: NO_OBJECTS; none does, with what was left out.
    """
    camera = -T_camera_table[:3, :3].T @ T_camera_table[:3, 3]
    high = np.flatnonzero((points[:, 2] > OBJECT_HEIGHT) & (np.abs(points) < FAR).all(axis=1))
    voxels = voxel_means(points[high], VOXEL, least=2)
    fixed = np.zeros(len(voxels), bool)
    for wall in walls(voxels, camera):
        fixed |= wall.holds(voxels)
    free = voxels[~fixed]
    outside = _outside(points, free[:, :2], T_camera_table)
    over = outside > OVER
    number = connected(free, GAP)
    tall = _largest(free[:, 2], number) >= TALL
    hangs = ~tall & (np.bincount(number, weights=over) >= OVER_SHARE * np.bincount(number))
    # What reaches over the edge may touch what stands on the table: it is cut off there.
    off = tall[number] | (hangs[number] & _near(free, free[over & hangs[number]]))
    left_out = int(fixed.any()) + (np.bincount(number[off]) >= PIECE).sum()
    cut, rim, others, free = hangs[number][~off], outside[~off] > -RIM, free[off], free[~off]
    number = connected(free, GAP)
    count = np.bincount(number)
    stands = _largest(-free[:, 2], number) > -FOOT
    length = np.hypot(*(_largest(free[:, k], number) + _largest(-free[:, k], number) for k in (0, 1)))
    thing = stands | ((length < LARGE) & (np.bincount(number, weights=cut) == 0))
    left_out += (~thing & (count >= PIECE)).sum()
    others = np.concatenate([others, free[(~thing & (count >= MIN_VOXELS))[number]]])
    # A side at a low angle falls into pieces, and pixels fly at the table's edge.
    beside = np.bincount(number, weights=_near(free, others) | rim) > 0
    kept = free[(thing & (count >= np.where(beside, PIECE, MIN_VOXELS)))[number]]
    if not len(kept):
        raise _nothing(int(left_out))
    on = np.zeros(len(points), bool)
    on[high] = cKDTree(kept).query(points[high], distance_upper_bound=1.5 * VOXEL)[0] < np.inf
    return on


def _largest(values: Array, number: NDArray[np.int64]) -> Array:
    """(K,) the largest of the values (N,) of each of the things that they belong to."""
    largest = np.full(number.max(initial=-1) + 1, -np.inf)
    np.maximum.at(largest, number, values)
    return largest


def _near(voxels: Array, others: Array) -> Mask:
    """(V,) which voxels are nearer than `NEAR` to one of the others, as seen from above."""
    return np.asarray(cKDTree(others[:, :2]).query(voxels[:, :2], distance_upper_bound=NEAR)[0] < NEAR)


def _nothing(others: int) -> DgsError:
    rest = f"; {others} that stand there reach over its edge or are too large" if others else ""
    cure = "show the whole table, mark the things with a mask, or take the cell's camera (--in-cell)"
    return DgsError(
        ErrorCode.NO_OBJECTS, f"nothing that a hand could grasp stands on the table{rest}: {cure}"
    )


def _outside(points: NDArray, places: Array, T_camera_table: Array) -> Array:
    """(V,) how far outside of the table's outline places (V, 2) lie [m]; -inf where the picture may end before it."""
    near = points[(np.abs(points) < (FAR, FAR, TALL)).all(axis=1)]
    cell = np.floor(near[:, :2] / 0.01).astype(np.int64)
    low = cell.min(axis=0) - 3
    level, count = (np.zeros(cell.max(axis=0) - low + 4) for _ in range(2))
    np.add.at(count, tuple((cell - low).T), 1.0)
    np.add.at(level, tuple((cell - low).T), np.abs(near[:, 2]) < OBJECT_HEIGHT)
    seen = level > 0.5 * count  # the foot of a side is no table
    parts, _ = label(binary_closing(seen, iterations=3))
    sizes = np.bincount(parts[seen])
    table = np.isin(parts, np.flatnonzero(sizes > 0.1 * sizes.max())) & seen
    try:
        hull = ConvexHull((np.argwhere(table) + low + 0.5) * 0.01).equations
    except QhullError:  # the table is seen as a line
        return np.full(len(places), -np.inf)
    outside = (places @ hull[:, :2].T + hull[:, 2]).max(axis=1)
    ray = apply(T_camera_table, points.astype(np.float64))
    edge = np.percentile(ray[:, :2] / ray[:, 2:], (1, 99), axis=0)
    foot = apply(T_camera_table, np.column_stack([places, np.zeros(len(places))]))
    pixel = foot[:, :2] / np.maximum(foot[:, 2:], 1e-3)
    return np.where(((pixel > edge[0]) & (pixel < edge[1])).all(axis=1), outside, -np.inf)

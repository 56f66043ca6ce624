"""The observed cloud as an obstacle: voxels without the table's, objects told apart, an octree for coal."""

from __future__ import annotations

from dataclasses import dataclass, field

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dgs_description.cell import CELL
from dgs_description.cloud import connected, finite_rows, voxel_means
from dgs_description.frames import Array, apply, inverse, transform
from dgs_description.grasp import GraspSet

RESOLUTION = 0.008
"""Edge of an octree voxel [m]: a check against the cloud takes 0.02 ms with it."""
_ABOVE_TABLE = 0.012
"""Points lower than this above the table are the table's; what shows it 10 mm too high passes the check [m]."""
_OTHER = 0.03
"""Of one that is lower, the nearest voxel is another thing's if it is farther beside it than this [m]."""
_STRAY, _FRAGMENT = 0.016, 24
"""So few voxels, none higher above the table [m], may be the noise of a mat: no obstacle where one is pushed."""
_FAR = 3.0
"""What is farther off along an axis is out of the arm's way [m]."""
_MIN_POINTS = 2
"""Voxels with fewer points are stray measurements."""
_LINK_DISTANCE = 2.1 * RESOLUTION
"""Voxels nearer than this belong to the same object: next but one, so that a missing voxel does not split it [m]."""
_FRAGMENT_GAP = 0.04
"""`_FRAGMENT` voxels this near to more [m] belong to them: of what reaches down to the table, as the legs of a toy
animal or the foot of a clamp, only what stands out of the table's noise is an obstacle, and that falls apart."""
_MOVED, _CHANGED = 0.025, 6
"""So many voxels farther than this [m] from what was seen before: something has moved. Noise moves single ones."""
_RELEASE_RADIUS = 0.12
"""No point farther from the TCP than this is released with the target: a hand's span [m]."""
_ONE_THING = 0.3
"""What is longer than this, along an axis, is several things that touch [m]."""
_UPRIGHT = Rotation.from_rotvec(np.outer(np.deg2rad(np.arange(0, 90, 5)), (0, 0, 1))).as_matrix()
"""(18, 3, 3) turns about the vertical, to one of which every box is aligned within 2.5 degrees."""


@dataclass(frozen=True)
class ObstacleCloud:
    """Occupied voxels in `base_link` with the number of the object that each belongs to.

    Attributes:
        points: (V, 3) mean point of every occupied voxel [m].
        labels: (V,) object number.
    """

    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    labels: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def from_points(cls, points: ArrayLike) -> ObstacleCloud:
        """Obstacle of a cloud (N, 3) in `base_link` [m], without NaN rows, what is far off, and what is in the bin."""
        cloud = np.asarray(points, dtype=np.float64)
        cloud = cloud[finite_rows(cloud)]
        cloud = cloud[(np.abs(cloud) < _FAR).all(axis=1)]
        cloud = cloud[~_in_the_bin(cloud)]
        high = cloud[cloud[:, 2] > CELL.table_height + _ABOVE_TABLE]
        voxels = voxel_means(high, RESOLUTION, _MIN_POINTS)
        return cls(voxels, _with_fragments(voxels, connected(voxels, _LINK_DISTANCE)))

    def target_mask(self, grasp: GraspSet) -> NDArray[np.bool_]:
        """(V,) the voxels of one grasp's target: they do not count on the last part of the approach.

        They are those of the object at its reference point within the release radius of its TCP, wherever that comes.
        What is as low as the table has none but what is above it, and stray ones.
        """
        if not len(self.points):
            return np.zeros(0, dtype=bool)
        away = self.points - grasp.reference_point
        mine = self.labels == self.labels[np.argmin(np.linalg.norm(away, axis=1))]
        if grasp.reference_point[2] < CELL.table_height + _ABOVE_TABLE:
            beside = np.linalg.norm(away[:, :2], axis=1).min()
            mine = mine & (beside <= _OTHER) | self._stray()
        reach = _RELEASE_RADIUS + float(np.linalg.norm(grasp.motion))
        near = np.linalg.norm(self.points - grasp.closing_pose[:3, 3], axis=1) < reach
        return near & mine

    def _stray(self) -> NDArray[np.bool_]:
        """(V,) voxels of objects that may be the noise of something lower."""
        top = np.full(self.labels.max() + 1, -np.inf)
        np.maximum.at(top, self.labels, self.points[:, 2] - CELL.table_height)
        return ((top < _STRAY) & (np.bincount(self.labels) <= _FRAGMENT))[self.labels]

    def carried_mask(self, grasp: GraspSet) -> NDArray[np.bool_]:
        """(V,) the voxels that go where one grasp's target goes: of `target_mask`, or all of a large thing."""
        released = self.target_mask(grasp)
        whole = np.isin(self.labels, self.labels[released])
        is_one = whole.any() and np.ptp(self.points[whole], axis=0).max() < _ONE_THING
        return whole if is_one else released

    def without(self, mask: NDArray[np.bool_]) -> ObstacleCloud:
        """The cloud less the voxels (V,) of a mask, e.g. the target once it is gripped."""
        return ObstacleCloud(self.points[~mask], self.labels[~mask])

    def difference(self, before: ObstacleCloud, grasp: GraspSet) -> str:
        """What is otherwise than it was `before`, as far as it concerns one grasp; "" = nothing.

        That is what has come into the workspace anywhere, and what has gone around the grasp.
        """
        places = np.stack([grasp.pose[:3, 3], grasp.closing_pose[:3, 3]])
        near = (np.linalg.norm(before.points[:, None] - places, axis=2) < _RELEASE_RADIUS).any(axis=1)
        come = _unmatched(self.points[_in_workspace(self.points)], before.points)
        gone = _unmatched(before.points[near], self.points)
        if come >= _CHANGED or gone >= _CHANGED:
            seen = f"{come} voxels have come into the workspace and {gone} have gone around the grasp"
            return f"{seen} since it was planned"
        return ""

    def octree(self, keep: NDArray[np.bool_] | None = None) -> coal.OcTree | None:
        """Octree of the voxels (only `keep`), or None where there are none."""
        points = self.points if keep is None else self.points[keep]
        return coal.makeOctree(points, RESOLUTION) if len(points) else None


@dataclass(frozen=True)
class CarriedBox:
    """Box around the target, for the collision checks while it is carried.

    The camera sees upper sides: below every seen point the object is taken to be solid down to the table. The box
    stands upright when it is gripped, turned about the vertical so that its base is smallest.

    Attributes:
        T_tcp_box: (4, 4) its middle and axes in `hand_tcp`.
        size: (3,) [m].
    """

    T_tcp_box: Array
    size: Array

    @classmethod
    def from_points(cls, points: Array, T_base_tcp: Array) -> CarriedBox | None:
        """Box around (V, 3) points on a standing object, in `base_link` [m]; None without points."""
        if not len(points):
            return None
        turned = [points @ axes for axes in _UPRIGHT]
        best = int(np.argmin([np.ptp(each[:, :2], axis=0).prod() for each in turned]))
        low, high = turned[best].min(axis=0), turned[best].max(axis=0)
        low[2] = CELL.table_height
        T_base_box = transform(_UPRIGHT[best], _UPRIGHT[best] @ (low + high) / 2)
        return cls(inverse(T_base_tcp) @ T_base_box, high - low)

    def holds(self, points: Array, T_base_tcp: Array, margin: float = 0.02) -> NDArray[np.bool_]:
        """Which of (V, 3) points in `base_link` belong to the object or lie within `margin` of its box [m]."""
        local = apply(inverse(T_base_tcp @ self.T_tcp_box), points)
        return np.asarray((np.abs(local) < self.size / 2 + margin).all(axis=1))

    @property
    def below_tcp(self) -> float:
        """How far the object reaches beyond the TCP along the approach direction [m]."""
        along = self.T_tcp_box[2]
        return float(along[3] + np.abs(along[:3]) @ self.size / 2)


def _in_the_bin(points: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 3) [m] are of the bin, whose walls the model of the cell has, or deep in it."""
    x, y, height = CELL.bin_size
    beside = np.abs(points[:, :2] - CELL.bin_centre) < (x / 2 + RESOLUTION, y / 2 + RESOLUTION)
    return np.asarray(beside.all(axis=1) & (points[:, 2] < CELL.table_height + height))


def _with_fragments(points: Array, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """(V,) labels of (V, 3) points, small objects counted to the nearest one that is larger, where it is near."""
    sizes, labels = np.bincount(labels), labels.copy()
    for number in np.argsort(sizes, kind="stable").tolist():
        mine = labels == number
        others = ~mine
        if sizes[number] > _FRAGMENT or not others.any():
            break
        gaps, nearest = cKDTree(points[others]).query(points[mine], distance_upper_bound=_FRAGMENT_GAP)
        if np.isfinite(gaps).any():
            labels[mine] = labels[others][nearest[gaps.argmin()]]
    return labels


def _unmatched(points: Array, others: Array) -> int:
    """How many of (N, 3) points have none of the others (M, 3) within `_MOVED`."""
    if not len(points) or not len(others):
        return len(points)
    return int((cKDTree(others).query(points)[0] > _MOVED).sum())


def _in_workspace(points: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 3) [m] are over the workspace, where the robot is not while it is out of view."""
    low, high = CELL.workspace_bounds
    return np.asarray(((points > low) & (points < high)).all(axis=1))

"""The observed cloud as an obstacle: voxels without the table's, objects told apart, an octree for coal."""

from __future__ import annotations

from dataclasses import dataclass, field

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from dgs_description.cloud import connected, finite_rows, voxel_means
from dgs_description.frames import CELL, Array, apply, inverse
from dgs_description.grasp import GraspSet

RESOLUTION = 0.008
"""Edge of an octree voxel [m]: a check against the cloud takes 0.02 ms with it."""
_ABOVE_TABLE = 0.012
"""Points lower than this above the table are the table's; what shows it 10 mm too high passes the check [m]."""
_MIN_POINTS = 2
"""Voxels with fewer points are stray measurements."""
_LINK_DISTANCE = 2.1 * RESOLUTION
"""Voxels nearer than this belong to the same object: next but one, so that a missing voxel does not split it [m]."""
_FRAGMENT, _FRAGMENT_GAP = 24, 0.04
"""So few voxels this near to more [m] belong to them: of what reaches down to the table, as the legs of a toy animal or
the foot of a clamp, only what stands out of the table's noise is an obstacle, and that falls apart."""
_MOVED, _CHANGED = 0.025, 6
"""So many voxels farther than this [m] from what was seen before: something has moved. Noise moves single ones."""
_RELEASE_RADIUS = 0.12
"""No point farther from the TCP than this is released with the target: a hand's span [m]."""


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
        """Obstacle of a cloud (N, 3) in `base_link` [m], without its NaN rows."""
        cloud = np.asarray(points, dtype=np.float64)
        cloud = cloud[finite_rows(cloud)]
        high = cloud[cloud[:, 2] > CELL.table_height + _ABOVE_TABLE]
        voxels = voxel_means(high, RESOLUTION, _MIN_POINTS)
        return cls(voxels, _with_fragments(voxels, connected(voxels, _LINK_DISTANCE)))

    def target_mask(self, grasp: GraspSet) -> NDArray[np.bool_]:
        """(V,) the voxels of one grasp's target: they do not count on the last part of the approach.

        They are those of the object at its reference point within the release radius of its TCP, wherever that comes.
        """
        if not len(self.points):
            return np.zeros(0, dtype=bool)
        nearest = int(np.argmin(np.linalg.norm(self.points - grasp.reference_point, axis=1)))
        reach = _RELEASE_RADIUS + float(np.linalg.norm(grasp.motion))
        near = np.linalg.norm(self.points - grasp.closing_pose[:3, 3], axis=1) < reach
        return near & (self.labels == self.labels[nearest])

    def without(self, mask: NDArray[np.bool_]) -> ObstacleCloud:
        """The cloud less the voxels (V,) of a mask, e.g. the target once it is gripped."""
        return ObstacleCloud(self.points[~mask], self.labels[~mask])

    def difference(self, before: ObstacleCloud, grasp: GraspSet) -> str:
        """What is otherwise than it was `before`, as far as it concerns one grasp; "" = nothing.

        That is what has come into the workspace anywhere, and what has gone around the grasp.
        """
        near = np.linalg.norm(before.points - grasp.closing_pose[:3, 3], axis=1) < _RELEASE_RADIUS
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

    The camera sees upper sides: below every seen point the object is taken to be solid down to the table.

    Attributes:
        lower, upper: (3,) corners in `hand_tcp` [m].
    """

    lower: Array
    upper: Array

    @classmethod
    def from_points(cls, points: Array, T_base_tcp: Array) -> CarriedBox | None:
        """Box around (V, 3) points on a standing object, in `base_link` [m]; None without points."""
        if not len(points):
            return None
        feet = np.column_stack([points[:, :2], np.full(len(points), CELL.table_height)])
        local = apply(inverse(T_base_tcp), np.concatenate([points, feet]))
        return cls(local.min(0), local.max(0))

    def holds(self, points: Array, T_base_tcp: Array, margin: float = 0.02) -> NDArray[np.bool_]:
        """Which of (V, 3) points in `base_link` belong to the object or lie within `margin` of its box [m]."""
        local = apply(inverse(T_base_tcp), points)
        return np.asarray(((local > self.lower - margin) & (local < self.upper + margin)).all(axis=1))

    @property
    def below_tcp(self) -> float:
        """How far the object reaches beyond the TCP along the approach direction, at least 0 [m]."""
        return max(0.0, float(self.upper[2]))


def _with_fragments(points: Array, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """(V,) labels of (V, 3) points, small objects counted to the nearest one that is larger, where it is near."""
    sizes, labels = np.bincount(labels), labels.copy()
    for number in np.argsort(sizes, kind="stable").tolist():
        mine = labels == number
        others = ~mine & (sizes[labels] >= sizes[number])
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

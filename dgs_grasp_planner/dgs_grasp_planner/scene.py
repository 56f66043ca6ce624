"""What a planner is asked, one cloud with the caller's wishes, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.grasp import GraspSet
from dgs_description.stage_clock import StageClock
from dgs_description.table_fit import voxel_means
from dgs_grasp_planner.contact.height_field import HeightField, height_field
from dgs_grasp_planner.preprocess import CloudSettings, levelled, prepare_rows

Mask = NDArray[np.bool_]

VOXEL = 0.008
"""Edge of the cells of which `Scene.voxels` has one point each [m]."""


@dataclass(frozen=True)
class Region:
    """A box outside of which nothing is grasped.

    Attributes:
        T_table_box: (4, 4) pose of the box's centre in the table frame.
        size: (3,) edge lengths [m].
    """

    T_table_box: Array
    size: Array

    def contains(self, points: Array) -> Mask:
        """(N,) which of the points (N, 3) [m], table frame, lie inside."""
        local = (points - self.T_table_box[:3, 3]) @ self.T_table_box[:3, :3]
        return np.asarray((np.abs(local) <= self.size / 2).all(axis=1))


@dataclass(frozen=True)
class PlanRequest:
    """What a caller may wish besides the cloud; None = the planner's default."""

    max_grasps: int | None = None
    min_score: float | None = None
    region: Region | None = None

    def wanted(self, points: Array) -> Mask:
        """(N,) at which of the points (N, 3) [m], table frame, something may be grasped."""
        return np.ones(len(points), bool) if self.region is None else self.region.contains(points)

    def admitted(self, grasps: GraspSet) -> GraspSet:
        """Those grasps (table frame) whose score and reference point are as wished."""
        good = self.wanted(grasps.reference_point)
        return grasps[good & (grasps.score >= (self.min_score or 0.0))]


@dataclass(frozen=True)
class Scene:
    """One cloud as proposers and stages see it, frame *table*.

    Attributes:
        points: (N, 3) float32 points near objects [m].
        camera: (3,) position of the camera [m].
        rng: for proposers that draw.
        request: the caller's wishes.
        clock: takes the times of the stages.
        object_height: what is lower is table, for all points or (N,) [m].
        edge: the table is where x is larger [m]; None = no edge is known.
    """

    points: NDArray[np.float32]
    camera: Array
    rng: np.random.Generator
    request: PlanRequest = field(default_factory=PlanRequest)
    clock: StageClock = field(default_factory=StageClock)
    object_height: float | NDArray = OBJECT_HEIGHT
    edge: float | None = None

    @cached_property
    def field(self) -> HeightField | None:
        """What stands on the table, hidden sides guessed from symmetry; None where nothing does."""
        with self.clock("height_field"):
            # A plate is known from a ring only where there is something to do with it: push it over the edge.
            low = None if self.edge is None else self.points[self.points[:, 2] <= self.object_height]
            return height_field(self._high, self.camera, low)

    @cached_property
    def _high(self) -> NDArray[np.float32]:
        return self.points[self.points[:, 2] > self.object_height]

    def share_of_high(self, places: Array, radius: float = 0.02) -> Array:
        """(K,) how many of the points within `radius` of (K, 3) places, seen from above, are no table [m]."""
        near = np.linalg.norm(self.points[:, :2] - places[:, None, :2], axis=-1) < radius
        high = self.points[:, 2] > self.object_height
        return np.asarray((near & high).sum(axis=1) / np.maximum(near.sum(axis=1), 1))

    @cached_property
    def voxels(self) -> Array:
        """(V, 3) mean of the objects' points of every cell of edge `VOXEL` [m]."""
        return voxel_means(self._high, VOXEL)


@dataclass(frozen=True)
class Prediction:
    """A planner's answer.

    Attributes:
        grasps: in the table frame, best first.
        points_used: points of the cloud that were looked at.
        stage_times: seconds per stage, and `total`.
        rejected: number of candidates per reason of rejection.
        too_wide: where there is no grasp, the widths of what no turn of the hand would fit around [m].
    """

    grasps: GraspSet
    points_used: int
    stage_times: dict[str, float]
    rejected: dict[str, int] = field(default_factory=dict)
    too_wide: tuple[float, ...] = ()


Planner = Callable[[NDArray[np.float32], ArrayLike, np.random.Generator, PlanRequest], Prediction]
"""What node, evaluation and commands call: cloud (N, 3) and camera (3,) in the table frame [m], generator, wishes."""


def prepare(
    cloud: NDArray[np.float32],
    camera: ArrayLike,
    rng: np.random.Generator,
    request: PlanRequest,
    settings: CloudSettings,
    edge: float | None = None,
) -> Scene:
    """The scene of a cloud.

    Args:
        cloud: (N, 3) [m] in the table frame.
        camera: (3,) its position there [m].
        rng: decides which points are kept where there are too many.
        request: wishes of this call.
        settings: what of a cloud is kept.
        edge: the table is where x is larger [m]; None = no edge is known.

    Raises:
        DgsError: CLOUD_FORMAT, CLOUD_EMPTY, CLOUD_NOT_FINITE, NO_OBJECTS.
    """
    clock = StageClock()
    with clock("prepare"):
        position = np.asarray(camera, np.float64)
        seen, object_height = levelled(cloud, position)
        rows = prepare_rows(seen, rng, settings, object_height)
    return Scene(seen[rows], position, rng, request, clock, object_height[rows], edge)

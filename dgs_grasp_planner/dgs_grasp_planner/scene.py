"""What a planner is asked, one cloud with the caller's wishes, and what it answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from dgs_description.cloud import connected, voxel_means
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.grasp import GraspSet
from dgs_description.stage_clock import StageClock
from dgs_grasp_planner.contact.height_field import NEAR, HeightField, height_field
from dgs_grasp_planner.low_things import low_things
from dgs_grasp_planner.preprocess import check_points, prepare_rows
from dgs_grasp_planner.surroundings import FAR, GAP, VOXEL, Mask, walls
from dgs_grasp_planner.table_seen import check_table, levelled, why_empty

Made = TypeVar("Made")

HAND_REACH = 0.35
"""A hand that grasps a thing is nowhere farther from it, its approach included [m]."""
MISS = 0.03
"""A target point so near to a thing is meant for it: depth at an edge is noisy [m]."""


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
        """(..., N) which of the points (..., N, 3) [m], table frame, lie inside."""
        local = (points - self.T_table_box[:3, 3]) @ self.T_table_box[:3, :3]
        return np.asarray((np.abs(local) <= self.size / 2).all(axis=-1))

    def entered(self, points: Array, way: Array, margin: Array) -> Mask:
        """(K,) whether one of the points (K, N, 3) comes inside on a straight way (K, 3), or `margin` (N, 1) beside.

        Lengths in metres. Per axis the box is a slab, entered and left after a share of the way.
        """
        turn, place = self.T_table_box[:3, :3].T, self.T_table_box[:3, 3]
        # Coordinates first: numpy is slow along an axis of length three.
        start = (turn @ (points.reshape(-1, 3) - place).T).reshape(3, *points.shape[:2])
        step = (turn @ way.T)[:, :, None]
        step = np.where(np.abs(step) < 1e-9, 1e-9, step)
        middle, half = -start / step, (self.size / 2 + margin).T[:, None] / np.abs(step)
        enter, leave = (middle - half).max(axis=0), (middle + half).min(axis=0)
        return np.asarray((np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)).any(axis=1))


@dataclass(frozen=True)
class PlanRequest:
    """What a caller may wish besides the cloud; None = the planner's default.

    Attributes:
        region: nothing is grasped outside of it.
        targets: (M, 3) points on the things to grasp, table frame [m]; None = any thing.
        keep_out: where nothing is grasped and no hand goes.
        failed: (F, 4, 4) poses of `hand_tcp`, table frame, that were tried in vain: what is much the same, or at the
            same thing, scores less.
        things: (V, 3) voxels of the things at the targets; `aimed` finds them.
    """

    max_grasps: int | None = None
    min_score: float | None = None
    region: Region | None = None
    targets: Array | None = None
    keep_out: tuple[Region, ...] = ()
    failed: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    things: Array | None = None

    def wanted(self, points: Array) -> Mask:
        """(N,) at which of the points (N, 3) [m], table frame, something may be grasped."""
        wanted = np.ones(len(points), bool) if self.region is None else self.region.contains(points)
        for box in self.keep_out:
            wanted &= ~box.contains(points)
        if self.things is not None:
            wanted &= cKDTree(self.things).query(points)[0] < GAP
        return wanted

    def aimed(self, voxels: Array) -> PlanRequest:
        """The same wishes, knowing the things at the targets from the voxels (V, 3) of a scene [m].

        Things that touch are one. Raises DgsError NO_OBJECTS: nothing stands at any target.
        """
        away, nearest = cKDTree(voxels).query(self.targets)
        if not (away < MISS).any():
            nearest_away = float(np.min(away))
            near = f"{1e3 * nearest_away:.0f} mm" if nearest_away < FAR else f"more than {FAR:g} m"
            raise DgsError(
                ErrorCode.NO_OBJECTS,
                f"nothing stands at the target points; the nearest thing is {near} away",
            )
        labels = connected(voxels, GAP)
        return replace(self, things=voxels[np.isin(labels, labels[nearest[away < MISS]])])

    def admitted(self, grasps: GraspSet, voxels: Array, shapes: HeightField | None = None) -> GraspSet:
        """Those (table frame) whose score and reference point are as wished; of pushes no score is asked.

        What is pushed or turned over has its reference point in its middle, where bowls are hollow: of the scene's
        voxels (V, 3) [m] the one next to it counts. Which thing a grasp is at, `shapes` say where they know the
        targets' things: next to the middle of a plate there may be no voxel of it.
        """
        wishes = self
        if self.things is not None and shapes is not None:
            numbers = np.unique(shapes.nearest(self.things, GAP))
            if numbers.any():
                own = np.isin(shapes.nearest(grasps.reference_point, NEAR), numbers[numbers > 0])
                grasps, wishes = grasps[own], replace(self, things=None)
        places, moved = grasps.reference_point.copy(), ~grasps.holds
        places[moved] = voxels[cKDTree(voxels[:, :2]).query(places[moved, :2])[1]]
        good = wishes.wanted(places)
        return grasps[good & (~grasps.holds | (grasps.score >= (self.min_score or 0.0)))]


@dataclass(frozen=True)
class Scene:
    """One cloud as proposers and stages see it, frame *table*.

    Attributes:
        points: (N, 3) float32 points near objects [m].
        camera: (3,) position of the camera [m].
        rng: for proposers that draw.
        request: the caller's wishes.
        clock: takes the times of the stages.
        object_height: what is lower is table, for all points or (N,); less at what lies flat [m].
        edge: the table is where x is larger [m]; None = no edge is known.
        walls: (W, 3) voxels of walls, which are no part of `points`: no hand may cut them [m].
    """

    points: NDArray[np.float32]
    camera: Array
    rng: np.random.Generator
    request: PlanRequest = field(default_factory=PlanRequest)
    clock: StageClock = field(default_factory=StageClock)
    object_height: float | NDArray = OBJECT_HEIGHT
    edge: float | None = None
    walls: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @cached_property
    def field(self) -> HeightField:
        """What stands on the table, shapes completed. Raises DgsError NO_OBJECTS: nothing does."""
        with self.clock("height_field"):
            # A plate is known from a ring only where there is something to do with it: push it over the edge.
            table = self.points[~self._is_high]
            return height_field(self._high, self.camera, table, plates=self.edge is not None, least=0.0)

    @cached_property
    def _made(self) -> dict[Callable[[Scene], Any], Any]:
        return {}

    def once(self, make: Callable[[Scene], Made]) -> Made:
        """What is made of the scene whatever the `min_score` of its request: not made again for another one."""
        if make not in self._made:
            self._made[make] = make(self)
        made: Made = self._made[make]
        return made

    def asked(self, min_score: float) -> Scene:
        """The same for another `min_score`, with all that is known of it already."""
        other = replace(self, request=replace(self.request, min_score=min_score))
        known = {name: value for name, value in vars(self).items() if name not in self.__dataclass_fields__}
        other.__dict__.update(known)
        return other

    @cached_property
    def _is_high(self) -> Mask:
        return np.asarray(self.points[:, 2] > self.object_height)

    @cached_property
    def _high(self) -> NDArray[np.float32]:
        return self.points.compress(self._is_high, axis=0)

    def share_of_high(self, places: Array, radius: float = 0.02) -> Array:
        """(K,) how many of the points within `radius` of (K, 3) places, seen from above, are no table [m]."""
        near = cdist(places[:, :2], self.points[:, :2]) < radius
        return np.asarray((near & self._is_high).sum(axis=1) / np.maximum(near.sum(axis=1), 1))

    @cached_property
    def voxels(self) -> Array:
        """(V, 3) mean of the objects' points of every cell of edge `VOXEL` [m]."""
        return voxel_means(self._high, VOXEL)

    @property
    def obstacles(self) -> Array:
        """(V, 3) what no hand may cut: the voxels, and walls within its reach of them [m]."""
        low, high = self.voxels.min(axis=0) - HAND_REACH, self.voxels.max(axis=0) + HAND_REACH
        near = ((self.walls > low) & (self.walls < high)).all(axis=1)
        return np.concatenate([self.voxels, self.walls[near]])


@dataclass(frozen=True)
class Prediction:
    """A planner's answer.

    Attributes:
        grasps: in the table frame, best first.
        points_used: points of the cloud that were looked at.
        stage_times: seconds per stage, and `total`.
        rejected: number of candidates per reason of rejection.
        too_wide: where there is no grasp, the widths of what is wanted and no turn of the hand would fit around [m].
        wanted: whether there is a grasp, or a point of an object where one is wanted.
    """

    grasps: GraspSet
    points_used: int
    stage_times: dict[str, float]
    rejected: dict[str, int] = field(default_factory=dict)
    too_wide: tuple[float, ...] = ()
    wanted: bool = True


Planner = Callable[[NDArray[np.float32], ArrayLike, np.random.Generator, PlanRequest], Prediction]
"""What node, evaluation and commands call: cloud (N, 3) and camera (3,) in the table frame [m], generator, wishes."""


def prepare(
    cloud: NDArray[np.float32],
    camera: ArrayLike,
    rng: np.random.Generator,
    request: PlanRequest,
    keep_table: bool = False,
    edge: float | None = None,
) -> Scene:
    """The scene of a cloud.

    Args:
        cloud: (N, 3) [m] in the table frame; single points that are not finite are left out.
        camera: (3,) its position there [m].
        rng: decides which points are kept where there are too many.
        request: wishes of this call.
        keep_table: all of the table's points are kept, not only those near things.
        edge: the table is where x is larger [m]; None = no edge is known.

    Raises:
        DgsError: CLOUD_FORMAT, CLOUD_EMPTY, CLOUD_NOT_FINITE; CLOUD_NO_TABLE (it is elsewhere, or neither table nor
            things are seen); NO_OBJECTS, also at the request's targets.
    """
    clock = StageClock()
    with clock("prepare"):
        cloud, position = check_points(np.asarray(cloud), skip_invalid=True), np.asarray(camera, np.float64)
        check_table(cloud, position)
        seen, object_height = levelled(cloud, position)
        seen, object_height, fixed = _without_walls(seen, object_height, position)
        object_height = low_things(seen, object_height)
        try:
            rows = prepare_rows(seen, rng, object_height, keep_table)
        except DgsError as error:
            if error.code != ErrorCode.NO_OBJECTS:
                raise
            raise why_empty(seen, error) from error
    scene = Scene(seen[rows], position, rng, request, clock, object_height[rows], edge, fixed)
    return scene if request.targets is None else replace(scene, request=request.aimed(scene.voxels))


def _without_walls(
    points: NDArray[np.float32], object_height: NDArray, camera: Array
) -> tuple[NDArray[np.float32], NDArray, Array]:
    """Points and their heights without those of walls, and voxels (W, 3) of the walls [m]."""
    voxels = voxel_means(points.compress(points[:, 2] > object_height, axis=0), VOXEL)
    found = walls(voxels, camera)
    if not found:
        return points, object_height, np.zeros((0, 3))
    wall, fixed = (np.any([one.holds(place) for one in found], axis=0) for place in (points, voxels))
    return points[~wall], object_height[~wall], voxels[fixed]

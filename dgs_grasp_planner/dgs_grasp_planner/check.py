"""Rejects grasps whose hand would cut the table or the observed cloud, at the grasp or on the straight way to it.

The hand is the spheres of its fingers and the boxes of its palm. The way is a translation along the TCP's z axis, so
that a sphere sweeps a capsule and a box a longer box: distances to both have closed forms, no steps are needed. A
motion after it is looked at step by step, and so is the table where it has an edge: beyond it the hand may be lower.
What a push touches on its motion it is to touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import OBJECT_HEIGHT, Array, apply, inverse
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.pick import STAND_OFF
from dgs_grasp_planner.contact.closing import Mask, posed
from dgs_grasp_planner.scene import Region

TABLE_LIFT = 0.012
"""A grasp that is too low by no more than this is lifted instead of rejected [m]."""
CLOUD_DEPTH, CLOUD_POINTS = 0.005, 3
"""A cloud point counts when it is this deep inside the hand [m]; so many points are forgiven (noise, flying pixels),
for fingers and palm each."""
BETWEEN_RADIUS, BETWEEN_POINTS = 0.02, 3
"""So many points the lines from the thumb to the fingers must have within this radius [m]."""
STEP = 0.01
"""Between two places of a motion, or of a way near the table's edge, that are looked at [m]."""
_BOX_LOW, _BOX_HIGH = HAND.palm_boxes[:, 0::2], HAND.palm_boxes[:, 1::2]
_CORNERS = apply(
    inverse(HAND.T_base_tcp),
    np.concatenate([np.where(np.array(pick), _BOX_HIGH, _BOX_LOW) for pick in np.ndindex(2, 2, 2)]),
)
_PALM = HAND.palm_points()
_RADII = HAND.all_radii
_REACHES = np.concatenate([_RADII, np.full(len(_PALM), 0.005)])[:, None]
"""Of spheres and of points of the palm, which are 10 mm apart [m]."""


class Reason(Enum):
    """Why a grasp was rejected."""

    TABLE_AT_GRASP = "the pre-grasp shape cuts the table at the grasp"
    TABLE_IN_APPROACH = "the hand cuts the table on its way to the grasp"
    TABLE_CLOSED = "the closed hand cuts the table"
    FINGERS_IN_CLOUD = "a finger cuts observed points on the way"
    PALM_IN_CLOUD = "the palm cuts observed points on the way"
    MOTION_IN_CLOUD = "the hand cuts observed points on its motion after the approach"
    IN_KEEP_OUT = "the hand, or what it moves, enters a box to keep out of"
    NOTHING_BETWEEN = "nothing stands between thumb and fingers"


@dataclass(frozen=True)
class CheckResult:
    """Outcome for K grasps.

    Attributes:
        grasps: the K grasps, lifted where that saved them.
        accepted: (K,) bool.
        reasons: the first reason of every rejected grasp, None where accepted.
    """

    grasps: GraspSet
    accepted: Mask
    reasons: Sequence[Reason | None]

    def counts(self) -> dict[str, int]:
        """Number of rejected grasps per reason name."""
        names = [reason.name for reason in self.reasons if reason is not None]
        return {name: names.count(name) for name in dict.fromkeys(names)}


class _Table:
    """How low hands reach above the table.

    Attributes:
        x: (K, N) how far the balls that stand for a hand reach ahead of its TCP, z: how far up, lowest place [m].
        edge: the table is where x is larger [m]; None = everywhere.
    """

    def __init__(self, spheres: Array, grasps: GraspSet, edge: float | None, palm: bool):
        ahead, up = grasps.rotation[:, 0], grasps.rotation[:, 2]
        self.edge = edge
        self.x = np.einsum("ki,kni->kn", ahead, spheres) + _RADII
        self.z = np.einsum("ki,kni->kn", up, spheres) - _RADII
        if palm:
            # Of a box that crosses the edge the lowest place is no corner.
            boxes = _CORNERS if edge is None else _PALM
            self.x = np.concatenate([self.x, (boxes @ ahead.T).T], axis=1)
            self.z = np.concatenate([self.z, (boxes @ up.T).T], axis=1)

    def lowest(self, position: Array, rows: slice | NDArray = slice(None)) -> Array:
        """(K,) z of what is lowest above the table with the TCPs of hands `rows` at (K, 3) [m]; infinite beyond the
        edge."""
        above = True if self.edge is None else self.x[rows] + position[:, :1] > self.edge
        return np.asarray(np.where(above, self.z[rows], np.inf).min(axis=1) + position[:, 2])

    def lowest_on(self, start: Array, way: Array) -> Array:
        """(K,) the same on straight ways of (K, 3) from (K, 3) [m]: at an end, but where hands cross the edge."""
        end = start + way
        lowest = np.minimum(self.lowest(start), self.lowest(end))
        if self.edge is not None:
            rows = np.flatnonzero(self.x.min(axis=1) + np.minimum(start, end)[:, 0] <= self.edge)
            start, ways = start[rows], way[rows]
            lowest[rows] = np.min([self.lowest(start + share * ways, rows) for share in _shares(way)], axis=0)
        return lowest


def _shares(way: Array) -> Array:
    """(S,) places on (K, 3) ways [m] that are `STEP` apart at most, ends included."""
    longest = float(np.linalg.norm(way, axis=1).max(initial=0.0))
    return np.linspace(0.0, 1.0, int(np.ceil(longest / STEP)) + 1)


def _near_pairs(points: Array, grasps: GraspSet, spheres: Array, approach: float) -> tuple[NDArray, NDArray]:
    """Cloud points that may touch a hand: (P,) ascending grasp index, (P, 3) float32 position in its `hand_tcp`.

    The coordinates are contiguous in memory each: numpy is slow along an axis of length three.
    """
    low = np.minimum((spheres - _RADII[:, None]).min(axis=1), _CORNERS.min(axis=0)).astype(np.float32)
    high = np.maximum((spheres + _RADII[:, None]).max(axis=1), _CORNERS.max(axis=0)).astype(np.float32)
    low[:, 2] -= approach
    rotation = grasps.rotation.astype(np.float32)
    origin = np.einsum("ki,kij->jk", grasps.position, grasps.rotation).astype(np.float32)
    local = np.matmul(rotation.transpose(2, 0, 1), points.T.astype(np.float32)) - origin[:, :, None]
    x, y, z = (local > low.T[:, :, None]) & (local < high.T[:, :, None])
    near = np.flatnonzero(x & y & z)
    return near // len(points), local.reshape(3, -1).take(near, axis=1).T


def _fingers_in_cloud(grasp: NDArray, local: NDArray, spheres: Array, approach: float) -> Mask:
    centres, way = spheres.astype(np.float32), np.float32(approach)
    reach = np.maximum(_RADII - CLOUD_DEPTH, 0.0).astype(np.float32)[:, None]
    hit = np.zeros(len(spheres), bool)
    ends = np.searchsorted(grasp, np.arange(len(spheres) + 1))
    for k, (first, last) in enumerate(pairwise(ends)):  # one hand's arrays fit the cache
        x, y, gap = local[first:last].T[:, None] - centres[k].T[:, :, None]
        # Distance along z to the segment that the centre sweeps, from the grasp back by `approach`.
        gap = np.maximum(gap, 0.0) + np.minimum(gap + way, 0.0)
        inside = (x * x + y * y + gap * gap < reach * reach).any(axis=0)
        hit[k] = np.count_nonzero(inside) > CLOUD_POINTS
    return hit


def _palm_in_cloud(grasp: NDArray, local: NDArray, count: int, approach: float) -> Mask:
    """Points that the boxes meet on the way: each box is a slab per axis, entered and left after some way."""
    T_base_tcp = HAND.T_base_tcp.astype(np.float32)
    low, high = (_BOX_LOW + CLOUD_DEPTH).astype(np.float32), (_BOX_HIGH - CLOUD_DEPTH).astype(np.float32)
    ahead = np.where(np.abs(T_base_tcp[:3, 2]) < 1e-6, np.float32(1e-6), T_base_tcp[:3, 2])
    points = T_base_tcp[:3, :3] @ local.T + T_base_tcp[:3, 3:]
    enter, leave = np.float32(0.0), np.float32(approach)
    for axis in range(3):
        one, other = ((side[:, axis, None] - points[axis]) / ahead[axis] for side in (low, high))
        enter = np.maximum(enter, np.minimum(one, other))
        leave = np.minimum(leave, np.maximum(one, other))
    inside = (enter <= leave).any(axis=0)
    return np.asarray(np.bincount(grasp[inside], minlength=count) > CLOUD_POINTS)


def _motion_in_cloud(points: Array, grasps: GraspSet, spheres: Array, among: Mask) -> Mask:
    """Of those `among` the grasps that have a motion."""
    hit = np.zeros(len(grasps), bool)
    rows = np.flatnonzero(grasps.motion.any(axis=1) & among)
    moving, shapes = grasps[rows], spheres[rows]
    for share in _shares(moving.motion)[1:] if len(points) else ():
        there = replace(moving, position=moving.position + share * moving.motion)
        grasp, local = _near_pairs(points, there, shapes, 0.0)
        hit[rows] |= _fingers_in_cloud(grasp, local, shapes, 0.0)
        hit[rows] |= _palm_in_cloud(grasp, local, len(rows), 0.0)
    return hit


def _in_keep_out(
    boxes: Sequence[Region], grasps: GraspSet, spheres: Array, closed: Array, back: Array
) -> Mask:
    """Whether a hand enters a box, from (K, 3) `back` [m] before the grasp or on its motion, or what it pushes does.

    `spheres`, `closed`: (K, S, 3) of the fingers before they close, and then [m].
    """
    hit = np.zeros(len(grasps), bool)
    if not boxes:
        return hit
    palms = np.broadcast_to(_PALM, (len(grasps), *_PALM.shape))
    hands = posed(np.concatenate([spheres, palms], axis=1), grasps.position, grasps.rotation)
    fists = posed(closed, grasps.closing_pose[:, :3, 3], grasps.rotation)
    things, moved = grasps.reference_point[:, None], grasps.motion * ~grasps.holds[:, None]
    rows = np.flatnonzero(grasps.motion.any(axis=1))
    for box in boxes:
        hit |= box.entered(hands, back, _REACHES)
        hit[rows] |= box.entered(hands[rows], grasps.motion[rows], _REACHES)
        hit |= box.entered(fists, np.zeros_like(back), _RADII[:, None])
        hit |= box.entered(things, moved, np.zeros((1, 1)))
    return hit


def _something_between(grasp: NDArray, local: NDArray, grasps: GraspSet) -> Mask:
    """Seen along the TCP's z axis: points near a line thumb-finger, from the fingertips' plane back to the palm."""
    tips = HAND.fingertips(grasps.grasp_joints).astype(np.float32)
    x, y, z = local.T
    from_thumb = np.stack([x, y]) - tips[:, 0, :2].T[:, grasp]
    between = np.zeros(len(local), bool)
    for finger in range(1, HAND.finger_count):
        line = (tips[:, finger, :2] - tips[:, 0, :2]).T
        square = np.maximum((line**2).sum(axis=0), 1e-8)
        along = line[:, grasp]
        share = np.clip((from_thumb * along).sum(axis=0) / square[grasp], 0.0, 1.0)
        between |= ((from_thumb - share * along) ** 2).sum(axis=0) < BETWEEN_RADIUS**2
    between &= (z > -0.06) & (z < tips[:, :, 2].max(axis=1)[grasp] + 0.01)
    return np.asarray(np.bincount(grasp[between], minlength=len(grasps)) >= BETWEEN_POINTS)


def check(
    grasps: GraspSet,
    cloud: NDArray,
    edge: float | None = None,
    fixed: Array | None = None,
    keep_out: Sequence[Region] = (),
) -> CheckResult:
    """Check K grasps against table and cloud.

    Args:
        grasps: in the table frame (table top at z = 0).
        cloud: (M, 3) [m] in the table frame, a few thousand points (voxel centres).
        edge: the table is where x is larger [m]; None = everywhere.
        fixed: (F, 3) part of the cloud that pushes may not touch on their motion, either [m]; None = nothing.
        keep_out: boxes that neither a hand enters, nor the reference point of what a push or drag moves.
    """
    count = len(grasps)
    if count == 0:
        return CheckResult(grasps, np.zeros(0, dtype=bool), [])
    open_spheres = HAND.finger_spheres(grasps.pre_grasp_joints).reshape(count, -1, 3)
    closed_spheres = HAND.finger_spheres(grasps.grasp_joints).reshape(count, -1, 3)
    opened, closed = _Table(open_spheres, grasps, edge, True), _Table(closed_spheres, grasps, edge, False)
    back = -STAND_OFF * grasps.rotation[:, :, 2]
    lowest_open = opened.lowest_on(grasps.position, grasps.motion)
    lowest_closed = closed.lowest(grasps.closing_pose[:, :3, 3])
    lacking = np.maximum(-lowest_open, -lowest_closed)
    lift = np.where(lacking <= TABLE_LIFT, np.maximum(lacking, 0.0), 0.0)
    lifted = replace(grasps, position=grasps.position + np.outer(lift, (0.0, 0.0, 1.0)))
    lowest_open, lowest_closed = lowest_open + lift, lowest_closed + lift
    lowest_start = opened.lowest_on(lifted.position, back)
    tiny = 1e-9
    points = np.asarray(cloud, dtype=np.float64)
    points = points[points[:, 2] > OBJECT_HEIGHT]  # below is the table, checked as a plane
    grasp, local = closing = _near_pairs(points, lifted, open_spheres, STAND_OFF)
    if lifted.motion[lifted.holds].any():
        there = replace(lifted, position=lifted.position + lifted.motion)
        closing = _near_pairs(points, there, open_spheres, STAND_OFF)
    # Of what a push touches only what is to stay where it is counts.
    in_motion = _motion_in_cloud(points, lifted, open_spheres, lifted.holds)
    if fixed is not None:
        in_motion |= _motion_in_cloud(fixed, lifted, open_spheres, ~lifted.holds)
    failed: list[tuple[Reason, Mask]] = [
        (Reason.TABLE_AT_GRASP, lowest_open < -tiny),
        (Reason.TABLE_IN_APPROACH, lowest_start < -tiny),
        (Reason.TABLE_CLOSED, lowest_closed < -tiny),
        (Reason.FINGERS_IN_CLOUD, _fingers_in_cloud(grasp, local, open_spheres, STAND_OFF)),
        (Reason.PALM_IN_CLOUD, _palm_in_cloud(grasp, local, count, STAND_OFF)),
        (Reason.MOTION_IN_CLOUD, in_motion),
        (Reason.IN_KEEP_OUT, _in_keep_out(keep_out, lifted, open_spheres, closed_spheres, back)),
        (Reason.NOTHING_BETWEEN, lifted.holds & ~_something_between(*closing, lifted)),
    ]
    reasons: list[Reason | None] = [next((r for r, bad in failed if bad[k]), None) for k in range(count)]
    return CheckResult(lifted, np.array([reason is None for reason in reasons]), reasons)

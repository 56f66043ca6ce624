"""Rejects grasps whose hand would cut the table or the observed cloud, at the grasp or on the straight way to it.

The hand is the spheres of its fingers and the boxes of its palm. The way is a translation along the TCP's z axis, so
that a sphere sweeps a capsule and a box a longer box: distances to both have closed forms, no steps are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.grasp import GraspSet
from dgs_description.hand_model import PALM_BOXES, SPHERE_RADII, TCP_IN_BASE, finger_spheres, fingertips
from dgs_description.pick import STAND_OFF

Mask = NDArray[np.bool_]

_BOX_LOW = PALM_BOXES[:, 0::2] - TCP_IN_BASE
_BOX_HIGH = PALM_BOXES[:, 1::2] - TCP_IN_BASE
_CORNERS = np.stack(
    [np.where(np.array(pick), _BOX_HIGH, _BOX_LOW) for pick in np.ndindex(2, 2, 2)], axis=1
).reshape(-1, 3)
_RADII = np.tile(SPHERE_RADII, 5)


class Reason(Enum):
    """Why a grasp was rejected."""

    TABLE_AT_GRASP = "the pre-grasp shape cuts the table at the grasp"
    TABLE_IN_APPROACH = "the hand cuts the table on its way to the grasp"
    TABLE_CLOSED = "the closed hand cuts the table"
    FINGERS_IN_CLOUD = "a finger cuts observed points on the way"
    PALM_IN_CLOUD = "the palm cuts observed points on the way"
    NOTHING_BETWEEN = "nothing stands between thumb and fingers"


@dataclass(frozen=True)
class CheckSettings:
    """Lengths in metres."""

    approach: float = STAND_OFF
    """Length of the straight way along the TCP's z axis (paper: 0.1)."""
    table_clearance: float = 0.0
    """Height of the pre-grasp shape above the table, at the grasp and on the way."""
    closed_clearance: float = 0.0
    """Height of the final shape above the table."""
    table_lift: float = 0.012
    """A grasp that is too low by no more than this is lifted instead of rejected."""
    cloud_depth: float = 0.005
    """A cloud point counts when it is this deep inside the hand."""
    cloud_points: int = 3
    """Points inside that are forgiven (noise, flying pixels), for fingers and palm each."""
    between_radius: float = 0.02
    between_points: int = 3
    """Points that the lines from the thumb to the fingers must have within this radius; 0 switches the rule off."""


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


def _lowest(spheres: Array, grasps: GraspSet) -> Array:
    """(K,) z of the lowest point of the fingers, of (K, 50, 3) sphere centres in `hand_tcp`."""
    z = np.einsum("ki,kni->kn", grasps.rotation[:, 2], spheres) - _RADII
    return np.asarray(z.min(axis=1) + grasps.position[:, 2])


def _near_pairs(points: Array, grasps: GraspSet, spheres: Array, approach: float) -> tuple[NDArray, NDArray]:
    """Cloud points that may touch a hand: (P,) grasp index and (P, 3) float32 position in that grasp's `hand_tcp`."""
    low = np.minimum((spheres - _RADII[:, None]).min(axis=1), _BOX_LOW.min(axis=0)).astype(np.float32)
    high = np.maximum((spheres + _RADII[:, None]).max(axis=1), _BOX_HIGH.max(axis=0)).astype(np.float32)
    low[:, 2] -= approach
    rotation = grasps.rotation.astype(np.float32)
    origin = np.einsum("ki,kij->kj", grasps.position, grasps.rotation).astype(np.float32)
    local = np.matmul(points.astype(np.float32)[None], rotation) - origin[:, None]
    near = ((local > low[:, None]) & (local < high[:, None])).all(axis=2)
    return np.nonzero(near)[0], local[near]


def _fingers_in_cloud(grasp: NDArray, local: NDArray, spheres: Array, settings: CheckSettings) -> Mask:
    centres = spheres.astype(np.float32)[grasp]
    gap = local[:, None, 2] - centres[:, :, 2]
    # Distance along z to the segment that the centre sweeps, from the grasp back by `approach`.
    gap = np.maximum(gap, 0.0) + np.minimum(gap + np.float32(settings.approach), 0.0)
    squared = (
        (local[:, None, 0] - centres[:, :, 0]) ** 2 + (local[:, None, 1] - centres[:, :, 1]) ** 2 + gap * gap
    )
    reach = np.maximum(_RADII - settings.cloud_depth, 0.0).astype(np.float32)
    inside = (squared < reach * reach).any(axis=1)
    return np.asarray(np.bincount(grasp[inside], minlength=len(spheres)) > settings.cloud_points)


def _palm_in_cloud(grasp: NDArray, local: NDArray, count: int, settings: CheckSettings) -> Mask:
    depth = settings.cloud_depth
    low, high = (_BOX_LOW + depth).astype(np.float32), (_BOX_HIGH - depth).astype(np.float32)
    low[:, 2] -= settings.approach
    inside = ((local[:, None] > low) & (local[:, None] < high)).all(axis=2).any(axis=1)
    return np.asarray(np.bincount(grasp[inside], minlength=count) > settings.cloud_points)


def _something_between(grasp: NDArray, local: NDArray, grasps: GraspSet, settings: CheckSettings) -> Mask:
    """Seen along the TCP's z axis: points near a line thumb-finger, from the fingertips' plane back to the palm."""
    tips = fingertips(grasps.grasp_joints).astype(np.float32)
    start, along = tips[:, None, 0, :2], tips[:, 1:, :2] - tips[:, None, 0, :2]
    square = np.maximum((along**2).sum(-1), 1e-8)
    from_thumb = local[:, None, :2] - start[grasp]
    share = np.clip((from_thumb * along[grasp]).sum(-1) / square[grasp], 0.0, 1.0)
    distance2 = ((from_thumb - share[..., None] * along[grasp]) ** 2).sum(-1)
    z = local[:, 2]
    deep = (z > -0.06) & (z < tips[:, :, 2].max(axis=1)[grasp] + 0.01)
    between = (distance2 < settings.between_radius**2).any(axis=1) & deep
    return np.asarray(np.bincount(grasp[between], minlength=len(grasps)) >= settings.between_points)


def check(grasps: GraspSet, cloud: NDArray, settings: CheckSettings = CheckSettings()) -> CheckResult:
    """Check K grasps against table and cloud.

    Args:
        grasps: in the table frame (table top at z = 0).
        cloud: (M, 3) [m] in the table frame, a few thousand points (voxel centres).
        settings: limits.
    """
    count = len(grasps)
    if count == 0:
        return CheckResult(grasps, np.zeros(0, dtype=bool), [])
    open_spheres = finger_spheres(grasps.pre_grasp_joints).reshape(count, -1, 3)
    closed_spheres = finger_spheres(grasps.grasp_joints).reshape(count, -1, 3)
    palm = (_CORNERS @ grasps.rotation[:, 2].T).min(axis=0)
    lowest_open = np.minimum(_lowest(open_spheres, grasps), palm + grasps.position[:, 2])
    lowest_closed = _lowest(closed_spheres, grasps)
    lacking = np.maximum(settings.table_clearance - lowest_open, settings.closed_clearance - lowest_closed)
    lift = np.where(lacking <= settings.table_lift, np.maximum(lacking, 0.0), 0.0)
    lifted = replace(grasps, position=grasps.position + np.outer(lift, (0.0, 0.0, 1.0)))
    lowest_open, lowest_closed = lowest_open + lift, lowest_closed + lift
    # The way is straight: its lowest place is one of its ends.
    lowest_start = lowest_open - settings.approach * grasps.rotation[:, 2, 2]
    tiny = 1e-9
    points = np.asarray(cloud, dtype=np.float64)
    points = points[points[:, 2] > OBJECT_HEIGHT]  # below is the table, checked as a plane
    grasp, local = _near_pairs(points, lifted, open_spheres, settings.approach)
    failed: list[tuple[Reason, Mask]] = [
        (Reason.TABLE_AT_GRASP, lowest_open < settings.table_clearance - tiny),
        (Reason.TABLE_IN_APPROACH, lowest_start < settings.table_clearance - tiny),
        (Reason.TABLE_CLOSED, lowest_closed < settings.closed_clearance - tiny),
        (Reason.FINGERS_IN_CLOUD, _fingers_in_cloud(grasp, local, open_spheres, settings)),
        (Reason.PALM_IN_CLOUD, _palm_in_cloud(grasp, local, count, settings)),
        (Reason.NOTHING_BETWEEN, ~_something_between(grasp, local, lifted, settings)),
    ]
    reasons: list[Reason | None] = [next((r for r, bad in failed if bad[k]), None) for k in range(count)]
    return CheckResult(lifted, np.array([reason is None for reason in reasons]), reasons)

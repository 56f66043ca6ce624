"""Kinematic part of a trial.

Is the approach free, where do the fingers touch when they close, and does the touch oppose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.hand_model import SPHERE_PHALANX, SPHERE_RADII, SPHERES_PER_FINGER, finger_spheres
from dgs_grasp_planner.contact.closing import (
    ClosingPath,
    ContactPoints,
    contact_points,
    posed,
    touch,
)
from dgs_grasp_planner.contact.quality import pinch
from dgs_learning.synthesis.candidates import PALM, Candidates
from dgs_learning.synthesis.sdf import SignedDistance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

APPROACH = 0.1
"""Length of the straight approach along the TCP's z [m] (paper, section V-A)."""
CONTACT, TOUCH = 5e-4, 0.003
"""Clearance at which a finger stops, and up to which it counts as touching in the end: the steps are coarse [m]."""
_SWEEP = np.arange(0.0125, APPROACH + 1e-9, 0.0125)
_ALL_RADII = np.tile(SPHERE_RADII, 5)


def approach_is_free(
    candidates: Candidates, sdf: SignedDistance, joints: Array, tolerance: float = 0.0
) -> NDArray[np.bool_]:
    """(N,) whether a hand in shape `joints` (N, 5, 4) clears object and table at the grasp and along the approach.

    Tests stand in rising cost: fingers at the grasp, palm at the grasp, then the sweep backwards.
    """
    index: Index = np.arange(len(candidates))
    spheres = finger_spheres(joints).reshape(len(candidates), 5 * SPHERES_PER_FINGER, 3)

    def keep(index: Index, points: Array, radii: Array | float) -> Index:
        return index[(candidates[index].distance(sdf, points) - radii).min(1) > tolerance]

    index = keep(index, spheres[index], _ALL_RADII)
    if len(index):
        index = keep(index, np.broadcast_to(PALM, (len(index), *PALM.shape)), 0.0)
    for k, back in enumerate(_SWEEP):
        if not len(index):
            break
        shift = np.array([0.0, 0.0, -back])
        index = keep(index, spheres[index] + shift, _ALL_RADII)
        if len(index) and k % 2:
            index = keep(index, np.broadcast_to(PALM[::2] + shift, (len(index), len(PALM[::2]), 3)), 0.0)
    free = np.zeros(len(candidates), dtype=bool)
    free[index] = True
    return free


def opened(candidates: Candidates) -> Array:
    """(N, 5, 4) open hand: the targets' yaw, active fingers straight."""
    joints = candidates.target.copy()
    joints[..., 1:] = np.where(candidates.active[..., None], 0.0, joints[..., 1:])
    return joints


@dataclass(frozen=True)
class Closure(ContactPoints):
    """Where closing ends, in the object's frame.

    Attributes:
        joints: (N, 5, 4) contact posture [rad].
    """

    joints: Array


def close(candidates: Candidates, sdf: SignedDistance, start: Array, steps: int = 24) -> Closure:
    """Close every finger from `start` (N, 5, 4) towards its target until it touches the object.

    A finger stops at its first contact; if the proximal phalanx touched, its middle and distal joints go on.
    """
    at, target = candidates.position[:, None], candidates.target
    path = ClosingPath(np.stack([start, target], axis=1), candidates.active, span=(0.0, 1.0), idle=1.0)
    first = touch(path, at, candidates.rotation, sdf, steps, reach=CONTACT)
    joints = path.joints(first.reached)
    onward = joints.copy()
    onward[..., 2:] = np.where(
        (SPHERE_PHALANX[first.sphere] == 0)[..., None], target[..., 2:], joints[..., 2:]
    )
    path = replace(path, nodes=np.stack([joints, onward], axis=1))
    second = touch(path, at, candidates.rotation, sdf, steps, reach=CONTACT, proximal=False)
    joints = path.joints(second.reached)
    spheres = posed(finger_spheres(joints), candidates.position, candidates.rotation)
    gap = sdf.clearance(spheres)
    nearest = gap.argmin(-1)
    centre = np.take_along_axis(spheres, nearest[..., None, None], 2)[:, :, 0]
    point, normal = contact_points(centre, nearest, sdf)
    return Closure((gap.min(-1) < TOUCH) & candidates.active, point, normal, joints)


def opposes(closure: Closure, fingers: int, max_offset: float = 0.03) -> NDArray[np.bool_]:
    """(N,) cheap filter before physics: thumb and fingers oppose and the pinch line passes the centre of mass.

    Args:
        closure: where closing ended.
        fingers: of the pattern, 5, 3 or 2.
        max_offset: largest distance of the pinch line to the centre of mass [m]; a rim is always far from it.
    """
    found = pinch(closure)
    offset = np.linalg.norm(np.cross(found.thumb, found.line), axis=1)
    enough = closure.met[:, 0] & (found.others >= min(fingers - 1, 2))
    square = (found.opposition > (0.6 if fingers == 2 else 0.5)) & (found.thumb_alignment > 0.5)
    return enough & square & (offset < max_offset * (0.67 if fingers == 2 else 1.0))

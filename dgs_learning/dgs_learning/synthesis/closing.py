"""Kinematic part of a trial: is the approach free, where do closing fingers touch, and does the touch oppose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import ClosingPath, ContactPoints, contact_points, posed, touch
from dgs_grasp_planner.contact.quality import pinch
from dgs_learning.dataset import TOUCHING
from dgs_learning.synthesis.candidates import PALM, Candidates
from dgs_learning.synthesis.sdf import SignedDistance, signed_distance
from dgs_sim_bridge.render.object_model import ObjectModel

APPROACH = 0.1
"""Length of the straight approach along the TCP's z [m] (paper, section V-A)."""
CONTACT = 5e-4
"""Clearance at which a finger stops; the steps are coarse, so up to `TOUCHING` it counts as touching in the end [m]."""
_SWEEP = np.arange(0.0125, APPROACH + 1e-9, 0.0125)


def approach_is_free(
    candidates: Candidates, sdf: SignedDistance, tolerance: float = 0.0
) -> NDArray[np.bool_]:
    """(N,) whether the pre-grasp shape clears object and table by `tolerance` [m] at the grasp and on the approach.

    Tests stand in rising cost: fingers at the grasp, palm at the grasp, then the sweep backwards.
    """
    spheres = HAND.finger_spheres(candidates.grasps.pre_grasp_joints)
    spheres = spheres.reshape(len(candidates), len(HAND.all_radii), 3)
    free = np.ones(len(candidates), dtype=bool)

    def test(points: Array, radii: Array | float) -> None:
        index = np.flatnonzero(free)
        if len(index):
            there = np.broadcast_to(points, (len(free), *points.shape[-2:]))[index]
            free[index] = (candidates[index].distance(sdf, there) - radii).min(1) > tolerance

    test(spheres, HAND.all_radii)
    test(PALM, 0.0)
    for k, back in enumerate(_SWEEP):
        shift = np.array([0.0, 0.0, -back])
        test(spheres + shift, HAND.all_radii)
        if k % 2:
            test(PALM[::2] + shift, 0.0)
    return free


@dataclass(frozen=True)
class Closure(ContactPoints):
    """Where closing ends, in the object's frame, and the (N, F, 4) contact posture [rad]."""

    joints: Array


def close(candidates: Candidates, sdf: SignedDistance, steps: int = 24) -> Closure:
    """Close every finger from pre-grasp towards grasp joints until it touches the object.

    A finger stops at its first contact; if the proximal phalanx touched, its middle and distal joints go on.
    """
    grasps = candidates.grasps
    at, active = grasps.position[:, None], grasps.active_fingers
    start, target = (HAND.split(q) for q in (grasps.pre_grasp_joints, grasps.grasp_joints))
    path = ClosingPath(np.stack([start, target], axis=1), active, span=(0.0, 1.0), idle=1.0)
    first = touch(path, at, grasps.rotation, sdf, steps, reach=CONTACT)
    joints = path.joints(first.reached)
    onward = joints.copy()
    onward[..., 2:] = np.where((HAND.sphere_phalanx[first.sphere] == 0)[..., None], target, joints)[..., 2:]
    path = replace(path, nodes=np.stack([joints, onward], axis=1))
    second = touch(path, at, grasps.rotation, sdf, steps, reach=CONTACT, proximal=False)
    joints = path.joints(second.reached)
    spheres = posed(HAND.finger_spheres(joints), grasps.position, grasps.rotation)
    gap = sdf.clearance(spheres)
    nearest = gap.argmin(-1)
    centre = np.take_along_axis(spheres, nearest[..., None, None], 2)[:, :, 0]
    point, normal = contact_points(centre, nearest, sdf)
    return Closure((gap.min(-1) < TOUCHING) & active, point, normal, joints)


def gap_of(model: ObjectModel, grasps: GraspSet) -> Array:
    """(G, F) distance of every finger of closed hands to the object; grasps in its frame [m]."""
    spheres = posed(HAND.finger_spheres(grasps.grasp_joints), grasps.position, grasps.rotation)
    return signed_distance(model).clearance(spheres).min(axis=-1)


def opposes(closure: Closure, active: NDArray[np.bool_], max_offset: float) -> NDArray[np.bool_]:
    """(N,) cheap filter before physics: thumb and fingers oppose and the pinch line passes the centre of mass.

    Args:
        active: (N, F) fingers that take part; two fingers alone have to be more exact.
        max_offset: largest distance of the pinch line to the centre of mass [m]; a rim is always far from it.
    """
    found, fingers = pinch(closure), active.sum(axis=1)
    offset = np.linalg.norm(np.cross(found.thumb, found.line), axis=1)
    enough = closure.met[:, 0] & (found.others >= np.minimum(fingers - 1, 2))
    square = (found.opposition > np.where(fingers == 2, 0.6, 0.5)) & (found.thumb_alignment > 0.5)
    return enough & square & (offset < max_offset * np.where(fingers == 2, 0.67, 1.0))

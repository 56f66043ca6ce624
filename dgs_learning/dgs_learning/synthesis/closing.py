"""Kinematic part of a trial.

Is the approach free, where do the fingers touch when they close, and does the touch oppose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.hand_model import SPHERE_PHALANX, SPHERE_RADII, SPHERES_PER_FINGER, finger_spheres
from dgs_learning.synthesis.candidates import PALM, Candidates
from dgs_learning.synthesis.sdf import SignedDistance

Array = NDArray[np.float64]
Index = NDArray[np.int64]

APPROACH = 0.1
"""Length of the straight approach along the TCP's z [m] (paper, section V-A)."""
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
class Closure:
    """Where closing ends.

    Attributes:
        joints: (N, 5, 4) contact posture [rad].
        touch: (N, 5) active fingers that touch the object.
        points: (N, 5, 3) contact points, normals: (N, 5, 3) outward normals there (object frame).
    """

    joints: Array
    touch: NDArray[np.bool_]
    points: Array
    normals: Array


def close(candidates: Candidates, sdf: SignedDistance, start: Array, steps: int = 24) -> Closure:
    """Close every finger from `start` (N, 5, 4) towards its target until it touches the object.

    A finger stops at its first contact; if the proximal phalanx touched, its middle and distal joints go on.
    """
    count = len(candidates)
    rows, fingers = np.arange(count)[:, None], np.arange(5)[None]
    share = np.linspace(0, 1, steps)[None, :, None, None]

    def clearance(path: Array) -> Array:
        spheres = candidates.to_object(finger_spheres(path))
        return sdf(spheres) - SPHERE_RADII

    def first_hit(path: Array, ignore_proximal: bool) -> tuple[Array, NDArray[np.bool_], Array]:
        gap = clearance(path)
        if ignore_proximal:
            gap = np.where(SPHERE_PHALANX == 0, 1.0, gap)
        hit = gap.min(-1) < 5e-4
        step = np.where(hit.any(1), hit.argmax(1), steps - 1)
        return path[rows, step, fingers], hit.any(1), SPHERE_PHALANX[gap[rows, step, fingers].argmin(-1)]

    target = candidates.target
    joints, hit, phalanx = first_hit(start[:, None] + (target - start)[:, None] * share, False)
    onward = joints.copy()
    go_on = hit & (phalanx == 0)
    onward[..., 2:] = np.where(go_on[..., None], target[..., 2:], joints[..., 2:])
    joints, _, _ = first_hit(joints[:, None] + (onward - joints)[:, None] * share, True)
    spheres = candidates.to_object(finger_spheres(joints))
    gap = sdf(spheres) - SPHERE_RADII
    nearest = gap.argmin(-1)
    centres = np.take_along_axis(spheres, nearest[..., None, None], 2)[:, :, 0]
    normals = sdf.gradient(centres)
    return Closure(
        joints=joints,
        touch=(gap.min(-1) < 0.003) & candidates.active,
        points=centres - normals * SPHERE_RADII[nearest][..., None],
        normals=normals,
    )


def opposes(closure: Closure, fingers: int, max_offset: float = 0.03) -> NDArray[np.bool_]:
    """(N,) cheap filter before physics: thumb and fingers oppose and the pinch line passes the centre of mass.

    Args:
        closure: where closing ended.
        fingers: of the pattern, 5, 3 or 2.
        max_offset: largest distance of the pinch line to the centre of mass [m]; a rim is always far from it.
    """
    weight = closure.touch[:, 1:].astype(float)
    total = np.maximum(weight.sum(1, keepdims=True), 1.0)
    normal = (closure.normals[:, 1:] * weight[..., None]).sum(1) / total
    point = (closure.points[:, 1:] * weight[..., None]).sum(1) / total
    thumb_normal, thumb_point = closure.normals[:, 0], closure.points[:, 0]
    line = point - thumb_point
    line /= np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-6)
    opposition = -(thumb_normal * normal).sum(1)
    alignment = -(thumb_normal * line).sum(1)
    offset = np.linalg.norm(np.cross(thumb_point, line), axis=1)
    enough = closure.touch[:, 0] & (closure.touch[:, 1:].sum(1) >= min(fingers - 1, 2))
    square = (opposition > (0.6 if fingers == 2 else 0.5)) & (alignment > 0.5)
    return enough & square & (offset < max_offset * (0.67 if fingers == 2 else 1.0))

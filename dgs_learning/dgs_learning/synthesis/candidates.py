"""Candidate grasps of one object before any physics: TCP and fingertip constraint (paper, section V-A)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_description.hand_ik import inverse_kinematics
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.dataset import GUIDED, LEVEL, UNIFORM, VARIED, finger_pattern
from dgs_learning.synthesis.sdf import SignedDistance
from dgs_sim_bridge.render.object_model import ObjectModel

YAW_SLACK = np.deg2rad(4.0)
"""Long fingers keep their yaw this close to `HAND.spread`, or neighbours overlap in the circle [rad]."""

PALM = HAND.palm_points()
PALM_FRONT = PALM[PALM[:, 2] > -0.10][::3]
"""Points on the palm in `hand_tcp`, and a third of those less than 0.1 m behind the TCP, for a quick look [m]."""

TABLE_SHARE = 0.9
"""Share of guided draws that approach an object resting on a table from above."""
ALIGNED_SHARE = 0.5
"""Share of guided draws whose pinch direction (x) is turned onto the nearest surface's normal; without it walls and
rims are almost never met squarely."""
FRONT, LARGEST_FRONT = 0.035, 0.055
"""How far in front of the TCP the cross-section is drawn, and may be once the hand has backed off [m]."""
SHIFT, TURN, ONWARD = 0.006, np.deg2rad(8.0), 0.35
"""Of a variation: standard deviations of the TCP along each axis [m] and of its rotation vector [rad], and how far
beyond the known final joints it may close [rad]."""
MAX_TILT = np.deg2rad(60.0)
"""Between approach and vertical, of what approaches a resting object [rad]."""
WALL_STEPS, WALL_MOST = np.arange(0.002, 0.06 + 0.002, 0.002), 0.06 + 0.002
"""Where the end of the material is looked for, and what a thicker one counts [m]."""


@dataclass(frozen=True)
class Candidates:
    """N hands to try on one object.

    Attributes:
        grasps: in the object's frame; from the pre-grasp joints the fingers close towards the grasp joints, which the
            fingertip constraint asks for.
        up: (N, 3) direction that points up when the object rests as the candidate assumes; zero = in free space.
        support: (N,) height of the resting plane along `up` [m].
    """

    grasps: GraspSet
    up: Array
    support: Array

    def __len__(self) -> int:
        return len(self.grasps)

    def __getitem__(self, index: NDArray | slice) -> Candidates:
        return Candidates(self.grasps[index], self.up[index], self.support[index])

    def distance(self, sdf: SignedDistance, points: Array) -> Array:
        """(N, ...) distance of `hand_tcp` points to the nearer of the object and the plane it rests on [m]."""
        there = posed(points, self.grasps.position, self.grasps.rotation)
        shape = (-1, *(1,) * (points.ndim - 2))
        flat = there.reshape(len(there), math.prod(points.shape[1:-1]), 3)
        height = (flat @ self.up[:, :, None]).reshape(points.shape[:-1]) - self.support.reshape(shape)
        return np.minimum(sdf(there), np.where(np.any(self.up, axis=1).reshape(shape), height, np.inf))

    def moved_back(self, distance: Array) -> Candidates:
        """The hands moved against their approach by (N,) [m]."""
        position = self.grasps.position - self.grasps.rotation[:, :, 2] * distance[:, None]
        return replace(self, grasps=replace(self.grasps, position=position))

    def closed(self, joints: Array) -> Candidates:
        """The same hands with final joints (N, F, 4) and the pre-grasp of equation (9); a level pinch keeps its own."""
        own = (self.grasps.source == LEVEL)[:, None]
        equation = HAND.pre_grasp(joints, self.grasps.active_fingers).reshape(-1, HAND.joint_count)
        before = np.where(own, self.grasps.pre_grasp_joints, equation)
        final = joints.reshape(-1, HAND.joint_count)
        return replace(self, grasps=replace(self.grasps, pre_grasp_joints=before, grasp_joints=final))


def concatenate(groups: Sequence[Candidates]) -> Candidates:
    """One set of several."""
    up, support = (np.concatenate([getattr(g, name) for g in groups]) for name in ("up", "support"))
    return Candidates(joined([g.grasps for g in groups]), up, support)


def fingertip_targets(circle: NDArray[np.bool_], r: Array, h: Array) -> Array:
    """Equations (7) and (8): wanted fingertips (N, F, 3) in `hand_tcp` [m].

    The rectangle's y is mirrored against the printed (8b), which a right hand cannot reach (docs/hand.md).

    Args:
        circle: (N,) circular constraint, else rectangular.
        r: (N,) radius or half width [m].
        h: (N,) distance of the tips to the fingertip plane [m].
    """
    facts = HAND.grasp
    round_xy = r[:, None, None] * np.stack([np.cos(facts.circle), np.sin(facts.circle)], -1)
    others = np.repeat(-r[:, None], HAND.finger_count - 1, axis=1)
    x = np.concatenate([facts.thumb_share * r[:, None], others], axis=1)
    y = np.broadcast_to(facts.rectangle, x.shape)
    tips = np.empty((len(r), HAND.finger_count, 3))
    tips[..., :2] = np.where(circle[:, None, None], round_xy, np.stack([x, y], -1))
    tips[..., 2] = facts.tip_plane + h[:, None] + facts.tip_delta
    return tips


def open_hands(
    source: str, position: Array, rotation: Array, tips: Array, active: NDArray[np.bool_]
) -> GraspSet:
    """N grasps by fingertip constraints: closing starts with straight fingers at the yaw that it ends with.

    Args:
        source: how they were drawn.
        position: (N, 3) TCP [m], rotation: (N, 3, 3).
        tips: (N, F, 3) wanted fingertips in `hand_tcp` [m].
        active: (F,) fingers that take part.
    """
    target = inverse_kinematics(HAND, tips)
    target[:, 1:, 0] = HAND.spread[1:] + np.clip(target[:, 1:, 0] - HAND.spread[1:], -YAW_SLACK, YAW_SLACK)
    target[:, ~active] = HAND.split(HAND.open_hand)[~active]
    straight = np.where(HAND.flexes, np.maximum(HAND.split(HAND.lower), 0.0), target)
    return GraspSet.of(
        source,
        position=position,
        rotation=rotation,
        pre_grasp_joints=straight,
        grasp_joints=target,
        active_fingers=active,
    )


def sample_uniform(rng: np.random.Generator, model: ObjectModel, count: int, fingers: int) -> Candidates:
    """The paper's draw: TCP uniform in the bounding box, rotation uniform, r and h uniform."""
    low, high = model.bounds.astype(np.float64)
    tips = fingertip_targets(
        rng.random(count) < 0.5, rng.uniform(0.01, 0.05, count), rng.uniform(-0.03, 0.0, count)
    )
    position, rotation = rng.uniform(low, high, (count, 3)), Rotation.random(count, rng=rng).as_matrix()
    grasps = open_hands(UNIFORM, position, rotation, tips, finger_pattern(fingers))
    return Candidates(grasps, up=np.zeros((count, 3)), support=np.zeros(count))


def inside_points(rng: np.random.Generator, model: ObjectModel, sdf: SignedDistance, count: int) -> Array:
    """Points in the material: uniform in the box, those outside pulled in along the gradient (thin walls)."""
    low, high = model.bounds.astype(np.float64)
    points = rng.uniform(low, high, (count, 3)) * rng.uniform(0.2, 1.0, (count, 1))
    for _ in range(2):
        value = sdf(points)
        out = value > -0.001
        if out.any():
            points[out] -= sdf.normals(points[out]) * (value[out] + 0.0015)[:, None]
    return points


def _rotations_towards(rng: np.random.Generator, up: Array, max_tilt: float) -> Array:
    """(N, 3, 3) rotations whose approach (z) points against `up` within `max_tilt` [rad], any angle about it."""
    count = len(up)
    tilt = max_tilt * np.sqrt(rng.random(count))
    spin, azimuth = rng.uniform(-np.pi, np.pi, (2, count))
    local = Rotation.from_euler("ZYZ", np.stack([azimuth, tilt, spin - azimuth], -1)).as_matrix()
    helper = np.where(np.abs(up[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    x = np.cross(helper, up)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    down = np.stack([x, np.cross(-up, x), -up], -1)
    return down @ local


def _turned_onto(rotation: Array, direction: Array) -> Array:
    """Rotations (N, 3, 3) turned about their z so that x points as far as possible along `direction` (N, 3)."""
    z = rotation[:, :, 2]
    x = direction - (direction * z).sum(1, keepdims=True) * z
    length = np.linalg.norm(x, axis=1, keepdims=True)
    x = np.where(length > 0.3, x / np.maximum(length, 1e-9), rotation[:, :, 0])
    return np.stack([x, np.cross(z, x), z], -1)


def centred(
    sdf: SignedDistance, points: Array, direction: Array, steps: Array = WALL_STEPS, most: float = WALL_MOST
) -> tuple[Array, Array]:
    """Points (N, 3) of the material, moved along `direction` (N, 3) to its middle, and (N,) how wide it is there [m].

    Either way it ends at the first of `steps` that is outside, or counts `most`.
    """

    def way(along: Array) -> Array:
        outside = sdf(points[:, None] + steps[None, :, None] * along[:, None]) > 0
        return np.where(outside.any(1), steps[outside.argmax(1)], most)

    ahead, behind = way(direction), way(-direction)
    return points + direction * ((ahead - behind) / 2)[:, None], ahead + behind


def sample_guided(
    rng: np.random.Generator,
    model: ObjectModel,
    sdf: SignedDistance,
    count: int,
    fingers: int,
    rest_ups: Array,
) -> Candidates:
    """Guided draw: centre a graspable cross-section between thumb and fingers, then back off until the palm is free.

    Args:
        model: the object, sdf: its signed distance.
        count: candidates drawn before the cheap rejections; fewer come back.
        rest_ups: (M, 3) directions that point up in the object's resting poses (object frame).
    """
    points = inside_points(rng, model, sdf, count)
    resting = rng.random(count) < TABLE_SHARE
    up = np.where(resting[:, None], rest_ups[rng.integers(0, len(rest_ups), count)], 0.0)
    support = np.where(resting, (up @ model.vertices.T.astype(np.float64)).min(1), 0.0)
    rotation = Rotation.random(count, rng=rng).as_matrix()
    rotation[resting] = _rotations_towards(rng, up[resting], MAX_TILT)
    aligned = np.flatnonzero(rng.random(count) < ALIGNED_SHARE)
    normal = sdf.normals(points[aligned]) * rng.choice([-1.0, 1.0], (len(aligned), 1))
    rotation[aligned] = _turned_onto(rotation[aligned], normal)
    x = rotation[:, :, 0]
    points, width = centred(sdf, points, x)
    off_centre = np.linalg.norm(np.cross(points, x), axis=1)
    keep = (sdf(points) < 0) & (width < HAND.grasp.widest) & (off_centre < 0.05)
    points, rotation, up, support, width = (a[keep] for a in (points, rotation, up, support, width))
    front = rng.uniform(0.0, FRONT, len(points))
    tips = fingertip_targets(
        rng.random(len(points)) < 0.5,
        np.clip(rng.uniform(0.2, 0.9, len(points)) * width / 2, 0.006, 0.04),
        rng.uniform(-0.03, 0.0, len(points)),
    )
    position = points - rotation[:, :, 2] * front[:, None]
    grasps = open_hands(GUIDED, position, rotation, tips, finger_pattern(fingers))
    return palm_free(
        Candidates(grasps, up, support), sdf, np.arange(0.0, 0.061, 0.005), LARGEST_FRONT - front
    )


def sample_near(
    rng: np.random.Generator, model: ObjectModel, known: GraspSet, count: int, rest_ups: Array
) -> Candidates:
    """Variations of grasps that hold: the TCP moved and turned a little, the fingers closing anew.

    Args:
        model: the object.
        known: of it, in its frame; each is as likely to be varied as any other.
        rest_ups: (M, 3) directions that point up in its resting poses. A grasp belongs to the one that it approaches
            most squarely; farther than `MAX_TILT` from each, to free space.
    """
    grasps = known[rng.integers(0, len(known), count)]
    square = -grasps.rotation[:, :, 2] @ rest_ups.T
    resting = square.max(1) > np.cos(MAX_TILT)
    up = np.where(resting[:, None], rest_ups[square.argmax(1)], 0.0)
    support = np.where(resting, (up @ model.vertices.T.astype(np.float64)).min(1), 0.0)
    level = grasps.source == LEVEL
    bent = HAND.flexes & grasps.active_fingers[..., None]
    final = HAND.split(grasps.grasp_joints) + np.where(bent, ONWARD, 0.0)
    final = np.clip(final, HAND.split(HAND.lower), HAND.split(HAND.upper))
    straight = np.where(HAND.flexes, np.maximum(HAND.split(HAND.lower), 0.0), final)
    before = np.where(level[:, None, None], HAND.split(grasps.pre_grasp_joints), straight)
    turn = Rotation.from_rotvec(rng.normal(0.0, TURN, (count, 3))).as_matrix()
    position = grasps.position + rng.normal(0.0, SHIFT, (count, 3))
    varied = replace(
        grasps,
        source=np.where(level, LEVEL, VARIED),
        position=position,
        reference_point=position,
        rotation=grasps.rotation @ turn,
        pre_grasp_joints=before.reshape(count, -1),
        grasp_joints=final.reshape(count, -1),
    )
    return Candidates(varied, up, support)


def palm_free(drawn: Candidates, sdf: SignedDistance, steps: Array, most: ArrayLike = np.inf) -> Candidates:
    """The hands moved back by the first of `steps` [m], below `most` (N,), that frees the palm; others are left out."""
    count = len(drawn)
    most, back = np.broadcast_to(most, count), np.full(count, np.nan)
    for step in steps:
        waiting = np.flatnonzero(np.isnan(back) & (step < most))
        if not len(waiting):
            break
        palm = np.broadcast_to(PALM_FRONT - np.array([0, 0, step]), (len(waiting), *PALM_FRONT.shape))
        free = drawn[waiting].distance(sdf, palm).min(1) > 0.003
        back[waiting[free]] = step
    keep = np.flatnonzero(~np.isnan(back))
    return drawn[keep].moved_back(back[keep])

"""Kinematic closing: every finger bends along a path until one of its spheres meets the observed cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.grasp import GraspSet
from dgs_description.hand_model import SPHERE_RADII, SPHERES_PER_FINGER, finger_spheres
from dgs_description.joints import HAND_LOWER, HAND_UPPER
from dgs_grasp_planner.contact.height_field import HeightField

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

START, PREDICTED, END = 0.5, 2.0, 3.0
"""Progress where closing starts, where the hand has the proposed final shape, and where it gives up."""
OPENED = 2.5
"""The open hand is so many times as far from the final shape as the pre-grasp: straight, for one by equation (9)."""
BEYOND = np.array([0.0, 0.35, 0.25, 0.25])
"""How far past the proposed final joints a finger looks for contact [rad]."""
LARGEST_RETREAT = 0.25
"""Progress that a finger is taken back at most: one that slides along a surface does not leave it by opening."""
_LOWER, _UPPER = HAND_LOWER.reshape(5, 4), HAND_UPPER.reshape(5, 4)


@dataclass(frozen=True)
class ClosingPath:
    """K hands' ways of closing: wide open, pre-grasp, proposed final shape, beyond it.

    Attributes:
        nodes: (K, 4, 5, 4) joints at progress 0, 1, 2, 3 [rad].
        active: (K, 5) fingers that take part; the others stay as they are.
    """

    nodes: Array
    active: Mask

    def joints(self, progress: Array) -> Array:
        """(K, 5, 4) joints of (K, 5) progress per finger in [0, 3]."""
        low = np.clip(np.floor(progress).astype(int), 0, 2)
        share = (progress - low)[..., None]
        rows, fingers = np.arange(len(self.nodes))[:, None], np.arange(5)
        before, after = self.nodes[rows, low, fingers], self.nodes[rows, low + 1, fingers]
        return np.asarray((1 - share) * before + share * after)

    def repeated(self, times: int) -> ClosingPath:
        """Every hand `times` times."""
        return ClosingPath(np.repeat(self.nodes, times, axis=0), np.repeat(self.active, times, axis=0))


def closing_path(grasps: GraspSet) -> ClosingPath:
    """The paths of K candidates."""
    final = grasps.grasp_joints.reshape(-1, 5, 4)
    before = grasps.pre_grasp_joints.reshape(-1, 5, 4)
    opened = np.clip(final + OPENED * (before - final), _LOWER, _UPPER)
    beyond = np.clip(final + BEYOND, _LOWER, _UPPER)
    nodes = np.stack([opened, before, final, beyond], axis=1)
    active = grasps.active_fingers
    return ClosingPath(np.where(active[:, None, :, None], nodes, final[:, None]), active)


@dataclass(frozen=True)
class Touch:
    """Where N hands' fingers end.

    Attributes:
        progress: (N, 5) along the closing path, just before contact; `PREDICTED` where nothing was met.
        met: (N, 5) active fingers that met the cloud on their way; not those that stood in it at the start.
        point, normal: (N, 5, 3) contact point [m] and the cloud's outward normal there, frame *table*.
        speed: (N, 5) at which the touching sphere comes nearer along the normal [m per unit of progress].
    """

    progress: Array
    met: Mask
    point: Array
    normal: Array
    speed: Array

    def held_off(self, distance: float) -> Array:
        """(N, 5) progress at which the fingers that met something are still `distance` [m] away from it."""
        enough = np.maximum(self.speed, distance / LARGEST_RETREAT)
        return np.where(self.met, np.maximum(self.progress - distance / enough, START), self.progress)


def touch(
    path: ClosingPath,
    position: Array,
    rotation: Array,
    field: HeightField,
    steps: int = 13,
    halvings: int = 0,
) -> Touch:
    """Close hands until every active finger meets the cloud.

    Args:
        path: of K hands.
        position: (K, V, 3) places of `hand_tcp` to try, frame *table* [m].
        rotation: (K, 3, 3) of each hand.
        field: what stands there.
        steps: looked at along the path.
        halvings: of the last step, to tell where contact was.

    Returns:
        N = K * V hands, those of one candidate one after another.
    """
    count, variants = position.shape[:2]
    sampled = np.linspace(START, END, steps)
    shapes = np.stack([path.joints(np.full((count, 5), s)) for s in sampled], axis=1)
    local = finger_spheres(shapes).reshape(count, -1, 3)
    turned = (local @ rotation.transpose(0, 2, 1)).astype(np.float32)
    world = turned[:, None] + position[:, :, None].astype(np.float32)
    world = world.reshape(-1, steps, 5, SPHERES_PER_FINGER, 3)
    gap = field.clearance(world)
    hit = (gap.min(axis=-1) < 0) & np.repeat(path.active, variants, axis=0)[:, None]
    ends, step = hit.any(axis=1), hit.argmax(axis=1)
    rows, fingers, before = np.arange(len(world))[:, None], np.arange(5), np.maximum(step - 1, 0)
    free, touching = sampled[before], sampled[step]
    if halvings:
        wide, turn = path.repeated(variants), np.repeat(rotation, variants, axis=0).transpose(0, 2, 1)
    for _ in range(halvings):
        middle = (free + touching) / 2
        spheres = finger_spheres(wide.joints(middle)).reshape(len(world), -1, 3) @ turn + position.reshape(
            -1, 1, 3
        )
        inside = field.clearance(spheres.reshape(-1, 5, SPHERES_PER_FINGER, 3)).min(axis=-1) < 0
        free, touching = np.where(inside, free, middle), np.where(inside, middle, touching)
    sphere = gap[rows, step, fingers].argmin(axis=-1)
    centre = world[rows, before, fingers, sphere]
    normal = field.normals(centre)
    nearer = ((centre - world[rows, step, fingers, sphere]) * normal).sum(axis=-1)
    return Touch(
        progress=np.where(ends, free, PREDICTED),
        met=ends & (step > 0),
        point=centre - normal * SPHERE_RADII[sphere][..., None],
        normal=normal,
        speed=nearer / (sampled[1] - sampled[0]),
    )

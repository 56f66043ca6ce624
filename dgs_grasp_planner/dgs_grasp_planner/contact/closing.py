"""Kinematic closing: every finger bends along a path until one of its spheres meets something.

What it meets is an argument: the height field of a cloud, or the signed distance of a known object.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.hand_ik import reach_with_balls

Mask = NDArray[np.bool_]


class Surroundings(Protocol):
    """What stands where the hand closes: `HeightField` and the grasp synthesis' `SignedDistance`."""

    def clearance(self, spheres: NDArray) -> NDArray:
        """(..., S) distance of every sphere of a finger to what stands there, negative = inside [m].

        Args:
            spheres: (..., S, 3) centres in the order of `HAND.sphere_radii` [m].
        """

    def normals(self, points: NDArray) -> Array:
        """(..., 3) unit outward normals at (..., 3) points [m]."""


START, PREDICTED, END = 0.5, 2.0, 3.0
"""Progress where closing starts, where the hand has the proposed final shape, and where it gives up."""
OPENED = 2.5
"""The open hand is so many times as far from the final shape as the pre-grasp: straight, for one by equation (9)."""
BEYOND = HAND.flexes * (0.0, 0.35, 0.25, 0.25)
"""How far past the proposed final joints a finger looks for contact [rad] ..."""
AT_TABLE, ONWARD = 0.003, 1.5
"""... and of a hand whose final shape comes nearer to the table than this [m], so many times the way of its end balls
from the pre-grasp, straight on: they stay level, where a thumb that bends on rises as much as it moves."""
LARGEST_RETREAT = 0.25
"""Progress that a finger is taken back at most: one that slides along a surface does not leave it by opening."""
_LOWER, _UPPER = HAND.split(HAND.lower), HAND.split(HAND.upper)


@dataclass(frozen=True)
class ClosingPath:
    """K hands' ways of closing.

    Attributes:
        nodes: (K, M, F, 4) joints at progress 0, 1, ... M - 1 [rad].
        active: (K, F) fingers that take part; the others are in contact with nothing.
        span: progress where closing starts and where it gives up.
        idle: progress of a finger that meets nothing.
    """

    nodes: Array
    active: Mask
    span: tuple[float, float] = (START, END)
    idle: float = PREDICTED

    def joints(self, progress: Array) -> Array:
        """(K, ..., F, 4) joints of (K, ..., F) progress per finger in [0, M - 1]."""
        low = np.clip(np.floor(progress).astype(int), 0, self.nodes.shape[1] - 2)
        share = (progress - low)[..., None]
        rows = np.arange(len(self.nodes)).reshape(-1, *(1,) * (progress.ndim - 1))
        fingers = np.arange(HAND.finger_count)
        before, after = self.nodes[rows, low, fingers], self.nodes[rows, low + 1, fingers]
        return np.asarray(before + share * (after - before))

    def repeated(self, times: int) -> ClosingPath:
        """Every hand `times` times."""
        return replace(
            self, nodes=np.repeat(self.nodes, times, axis=0), active=np.repeat(self.active, times, axis=0)
        )


def closing_path(grasps: GraspSet) -> ClosingPath:
    """Paths of K candidates: wide open, pre-grasp, proposed final shape, beyond it; idle fingers stay."""
    final = HAND.split(grasps.grasp_joints)
    before = HAND.split(grasps.pre_grasp_joints)
    opened = np.clip(final + OPENED * (before - final), _LOWER, _UPPER)
    beyond = np.clip(final + BEYOND, _LOWER, _UPPER)
    low = np.flatnonzero(at_table(grasps.position, grasps.rotation, final))
    if len(low):
        start, end = HAND.end_balls(before[low]), HAND.end_balls(final[low])
        beyond[low] = reach_with_balls(HAND, end + ONWARD * (end - start))
    nodes = np.stack([opened, before, final, beyond], axis=1)
    active = grasps.active_fingers
    return ClosingPath(np.where(active[:, None, :, None], nodes, final[:, None]), active)


def at_table(position: Array, rotation: Array, final: Array) -> Mask:
    """(K,) hands, frame *table*, whose final shapes (K, F, 4) come nearer to the table than `AT_TABLE`."""
    return np.asarray(position[:, 2] - reach_below(final[:, None], rotation) < AT_TABLE)


def reach_below(shapes: Array, rotation: Array) -> Array:
    """(K,) how far the lowest sphere of (K, S, F, 4) shapes reaches below `hand_tcp` [m]."""
    spheres = HAND.finger_spheres(shapes).reshape(len(rotation), -1, 3)
    radii = np.tile(HAND.all_radii, shapes.shape[1])
    return np.asarray((radii - (spheres * rotation[:, None, 2]).sum(axis=-1)).max(axis=-1))


@dataclass(frozen=True)
class ContactPoints:
    """Where the fingers of N hands touch.

    Attributes:
        met: (N, F) active fingers that touch.
        point, normal: (N, F, 3) contact point [m] and the outward normal there.
    """

    met: Mask
    point: Array
    normal: Array


@dataclass(frozen=True)
class Touch(ContactPoints):
    """Where N hands' fingers end; `met` leaves out those that stood in something at the start.

    Attributes:
        progress: (N, F) along the closing path, just before contact; `ClosingPath.idle` where nothing was met.
        reached: (N, F) the same in contact, as far as the steps tell.
        sphere: (N, F) the sphere that touches first.
        speed: (N, F) at which it comes nearer along the normal [m per unit of progress].
    """

    progress: Array
    reached: Array
    sphere: NDArray[np.int64]
    speed: Array

    def held_off(self, distance: float) -> Array:
        """(N, F) progress at which the fingers that met something are still `distance` [m] away from it."""
        enough = np.maximum(self.speed, distance / LARGEST_RETREAT)
        return np.where(self.met, np.maximum(self.progress - distance / enough, START), self.progress)


def touch(
    path: ClosingPath,
    position: Array,
    rotation: Array,
    there: Surroundings,
    steps: int = 13,
    halvings: int = 0,
    reach: float = 0.0,
    proximal: bool = True,
) -> Touch:
    """Close hands until every active finger meets something.

    Args:
        path: of K hands.
        position: (K, V, 3) places of `hand_tcp` to try, in the frame of `there` [m].
        rotation: (K, 3, 3) of each hand.
        there: what stands there.
        steps: looked at along the path.
        halvings: of the last step, to tell where contact was.
        reach: clearance that counts as contact [m].
        proximal: whether contact of the proximal phalanx stops a finger.

    Returns:
        N = K * V hands, those of one candidate one after another.
    """
    stops = np.where((HAND.sphere_phalanx > 0) | proximal, reach, -np.inf).astype(np.float32)
    sampled = np.linspace(*path.span, steps)
    world = _spheres(path, position, rotation, sampled)
    gap = there.clearance(world) - stops
    wide = path.repeated(position.shape[1])
    hit = (gap.min(axis=-1) < 0) & wide.active[:, None]
    ends, step = hit.any(axis=1), hit.argmax(axis=1)
    rows, fingers, before = (
        np.arange(len(world))[:, None],
        np.arange(HAND.finger_count),
        np.maximum(step - 1, 0),
    )
    free, touching = sampled[before], sampled[step]
    turn = np.repeat(rotation, position.shape[1], axis=0)
    for _ in range(halvings):
        middle = (free + touching) / 2
        spheres = posed(HAND.finger_spheres(wide.joints(middle)), position.reshape(-1, 3), turn)
        inside = (there.clearance(spheres) - stops).min(axis=-1) < 0
        free, touching = np.where(inside, free, middle), np.where(inside, middle, touching)
    sphere = gap[rows, step, fingers].argmin(axis=-1)
    centre = world[rows, before, fingers, sphere]
    point, normal = contact_points(centre, sphere, there)
    nearer = ((centre - world[rows, step, fingers, sphere]) * normal).sum(axis=-1)
    return Touch(
        met=ends & (step > 0),
        point=point,
        normal=normal,
        progress=np.where(ends, free, path.idle),
        reached=np.where(ends, touching, path.idle),
        sphere=sphere,
        speed=nearer / (sampled[1] - sampled[0]),
    )


def closed(path: ClosingPath, position: Array, rotation: Array, there: Surroundings) -> Touch:
    """As `touch`, of hands at one place (K, 3) [m] each, as precisely as grasps are made."""
    return touch(path, position[:, None], rotation, there, steps=21, halvings=3)


def _spheres(path: ClosingPath, position: Array, rotation: Array, sampled: Array) -> NDArray[np.float32]:
    """(K * V, S, F, P, 3) spheres of the fingers at S values of the progress, as in `touch`.

    In memory the coordinates come first and the hands last: that makes long inner loops of what follows.
    """
    count, variants = position.shape[:2]
    progress = np.broadcast_to(sampled[:, None], (count, len(sampled), HAND.finger_count))
    local = HAND.finger_spheres(path.joints(progress).swapaxes(0, 1)).transpose(4, 2, 3, 0, 1)
    turn = rotation.transpose(1, 2, 0)
    turned = np.stack([sum(turn[i, j] * local[j] for j in range(3)).astype(np.float32) for i in range(3)])
    place = position.reshape(-1, 3).T.astype(np.float32)
    world = np.repeat(turned, variants, axis=-1) + place[:, None, None, None]
    return world.transpose(4, 3, 1, 2, 0)


def posed(points: Array, position: Array, rotation: Array) -> Array:
    """Points (N, ..., 3) of `hand_tcp` in the frame in which the hands stand at (N, 3) with axes (N, 3, 3)."""
    flat = points.reshape(len(points), math.prod(points.shape[1:-1]), 3)
    return (flat @ rotation.transpose(0, 2, 1) + position[:, None]).reshape(points.shape)


def contact_points(centre: NDArray, sphere: NDArray, there: Surroundings) -> tuple[Array, Array]:
    """(..., 3) points and outward normals where spheres number `sphere` (...) with `centre` (..., 3) touch [m]."""
    normal = there.normals(centre)
    return centre - normal * HAND.sphere_radii[sphere][..., None], normal

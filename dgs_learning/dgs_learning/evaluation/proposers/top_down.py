"""Geometric baseline: grasps from above across the narrow side, the fingers closed onto the solids under the cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import posed
from dgs_grasp_planner.contact.quality import pinch
from dgs_grasp_planner.scene import Scene
from dgs_learning.dataset import finger_pattern
from dgs_learning.evaluation.proposers.cloud_shape import CloudObject, cloud_objects
from dgs_learning.synthesis.candidates import (
    Candidates,
    centred,
    concatenate,
    fingertip_targets,
    open_hands,
    palm_free,
)
from dgs_learning.synthesis.closing import Closure, approach_is_free, close
from dgs_learning.synthesis.sdf import SignedDistance

TILTS = np.deg2rad([(0, 0), (25, 0), (-25, 0), (0, 25), (0, -25)])
"""Approach variants: turned about the pinch axis x and about the hand's y [rad]."""
DEPTH = 0.02
"""How far below the top the pinch line passes [m]."""
RIM_DEPTH = 0.010
"""The same on a rim [m]."""
INSETS = (0.005, 0.025)
"""How far the pinch line stays behind the middle of the closed fingertips [m]."""
ROUND = 1.3
"""Footprints with a smaller ratio of extents have no narrow side."""
TABLE_CLEARANCE = 0.002
MIN_R = {5: 0.008, 3: 0.002}
"""Of the constraint: on a thin wall the tips have to pass each other to press [m]."""
WIDTH_SHARE = 0.6
"""The fingertip constraint is this share of the width: what is narrower than the object presses on it."""

APPROACHED, PROPOSED = 60, 12
"""Of a cluster so many of the best hands of a kind are looked at for a free approach, and so many are proposed."""


Pinches = tuple[Array, Array]
"""N places to pinch: points (N, 3) in the material; unit directions (N, 3), level, from the fingers to the thumb."""


def pinches(shape: CloudObject) -> Pinches:
    """Across the narrow side: in the middle and at the quarters of the long axis."""
    tops = shape.tops
    centre = tops[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((tops[:, :2] - centre).T) + 1e-12 * np.eye(2))
    local = (tops[:, :2] - centre) @ axes  # columns: narrow, long
    low, high = np.percentile(local, 1, axis=0), np.percentile(local, 99, axis=0)
    extent, middle = high - low, centre + axes @ ((low + high) / 2)
    turns = (0.0, 15.0, -15.0) if extent[1] > ROUND * extent[0] else (0.0, 45.0, 90.0, 135.0)
    shares = (0.0, 0.18, -0.18) if extent[1] > 0.07 else (0.0,)
    narrow = np.arctan2(axes[1, 0], axes[0, 0])
    places = [middle + share * extent[1] * axes[:, 1] for share in shares]
    return _pinches(tops, [(x, y, narrow + np.deg2rad(turn)) for x, y in places for turn in turns], DEPTH)


def rim_pinches(shape: CloudObject) -> Pinches:
    """Across the wall of a hollow shape, at twelve places around it."""
    tops = shape.tops
    high = tops[tops[:, 2] > 0.8 * np.percentile(tops[:, 2], 95)]
    middle = (high[:, :2].min(axis=0) + high[:, :2].max(axis=0)) / 2
    bearing = np.arctan2(*(high[:, :2] - middle).T[::-1])
    rows = []
    for angle in np.arange(0.0, 2 * np.pi, np.pi / 6):
        near = np.abs((bearing - angle + np.pi) % (2 * np.pi) - np.pi) < np.pi / 12
        if near.sum() >= 3:
            rows.append((*np.median(high[near, :2], axis=0), angle))
    return _pinches(tops, rows, RIM_DEPTH)


def _pinches(tops: Array, rows: list[tuple[float, float, float]], depth: float) -> Pinches:
    """Of places (x, y, angle of the pinch line), for the thumb on either side, `depth` below the top there [m]."""
    values = np.array([(x, y, angle + half) for x, y, angle in rows for half in (0.0, np.pi)]).reshape(-1, 3)
    tree = cKDTree(tops[:, :2])
    around = tree.query_ball_point(tops[tree.query(values[:, :2])[1], :2], 0.008) if len(values) else []
    top = np.array([np.percentile(tops[near, 2], 80) for near in around])
    point = np.column_stack([values[:, :2], np.maximum(top - depth, 0.4 * top)])
    angle = values[:, 2]
    return point, np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])


def _rotations(direction: Array) -> Array:
    """(N, T, 3, 3) hands whose x is `direction` (N, 3), looking down, in every variant of `TILTS`."""
    down = np.array([0.0, 0.0, -1.0])
    y = np.cross(down, direction)
    base = np.stack([direction, y, np.broadcast_to(down, y.shape)], axis=-1)
    return base[:, None] @ Rotation.from_euler("XY", TILTS).as_matrix()


def candidates(sdf: SignedDistance, found: Pinches, fingers: int, circle: bool) -> Candidates:
    """Width-matched hands for every pinch, tilt and depth, slid back until palm and open fingers are free."""
    point, direction = found
    rotation = _rotations(direction).reshape(-1, 3, 3)
    point, x = np.repeat(point, len(TILTS), axis=0), rotation[:, :, 0]
    steps = np.arange(0.0, HAND.grasp.widest, 0.002)
    point, width = centred(sdf, point, x, steps, HAND.grasp.widest)
    keep = (width > 0.002) & (width < HAND.grasp.widest)
    point, rotation, width = point[keep], rotation[keep], width[keep]
    return concatenate([_placed(sdf, point, rotation, width, inset, fingers, circle) for inset in INSETS])


def _placed(
    sdf: SignedDistance, point: Array, rotation: Array, width: Array, inset: float, fingers: int, circle: bool
) -> Candidates:
    count = len(point)
    r = np.clip(WIDTH_SHARE * width / 2, MIN_R[fingers], 0.04)
    tips = fingertip_targets(np.full(count, circle), r, np.interp(r, [0.01, 0.04], [-0.024, -0.004]))
    active = finger_pattern(fingers)
    hands = open_hands("top_down", point, rotation, tips, active)
    tips = HAND.fingertips(hands.grasp_joints)
    middle = (tips[:, 0] + tips[:, 1:][:, active[1:]].mean(axis=1)) / 2
    middle[:, 2] -= inset
    hands = replace(hands, position=point - np.einsum("nij,nj->ni", rotation, middle))
    drawn = Candidates(hands, up=np.tile([0.0, 0.0, 1.0], (count, 1)), support=np.zeros(count))
    drawn = _above_table(drawn.closed(hands.grasp_joints))
    placed = palm_free(drawn, sdf, np.arange(0.0, 0.061, 0.004))
    spheres = HAND.finger_spheres(placed.grasps.pre_grasp_joints)
    free = (placed.distance(sdf, spheres) - HAND.sphere_radii).min(axis=(1, 2)) > -0.004
    return placed[free]


def _above_table(drawn: Candidates) -> Candidates:
    """Slid back along the approach until the pre-grasp of the target shape clears the table."""
    grasps = drawn.grasps
    spheres = posed(HAND.finger_spheres(grasps.pre_grasp_joints), grasps.position, grasps.rotation)
    lowest = (spheres[..., 2] - HAND.sphere_radii).min(axis=(1, 2))
    steep = np.maximum(-grasps.rotation[:, 2, 2], 0.3)
    return drawn.moved_back(np.maximum(TABLE_CLEARANCE - lowest, 0.0) / steep)


def score(hands: Candidates, closure: Closure, shape: CloudObject) -> Array:
    """(N,) in [0, 1]: opposition of the contacts, fingers that touch, pinch through the centre, depth, steepness."""
    found = pinch(closure)
    alignment = np.minimum(found.thumb_alignment, found.finger_alignment)
    tops = shape.tops
    centre = np.array([*np.average(tops[:, :2], axis=0, weights=tops[:, 2]), tops[:, 2].mean() / 2])
    offset = np.linalg.norm(np.cross(found.thumb - centre, found.line), axis=1)
    depth = tops[:, 2].max() - (found.thumb[:, 2] + found.fingers[:, 2]) / 2
    others = hands.grasps.active_fingers[:, 1:].sum(axis=1)
    enough = closure.met[:, 0] & (found.others >= np.minimum(2, others))
    quality = (
        0.30 * np.clip(found.opposition, 0, 1)
        + 0.25 * np.clip(alignment, 0, 1)
        + 0.15 * closure.met.mean(axis=1)
        + 0.15 * np.clip(1 - offset / 0.05, 0, 1)
        + 0.10 * np.clip(depth / 0.03, 0, 1)
        + 0.05 * np.clip(-hands.grasps.rotation[:, 2, 2], 0, 1)
    )
    return np.where(enough & (found.opposition > 0.3) & (alignment > 0.3), quality, 0.0)


def grasps_of(shape: CloudObject) -> GraspSet:
    """The best free grasps of one cluster, best first: around it, and on the rim of a hollow one."""
    around, found = shape.filled or shape.sdf, pinches(shape)
    sets = [_closed(around, candidates(around, found, 5, circle), shape) for circle in (False, True)]
    if shape.filled is not None:
        sets.append(_closed(shape.sdf, candidates(shape.sdf, rim_pinches(shape), 3, True), shape))
    return joined(sets).best_first()[:PROPOSED]


def _closed(sdf: SignedDistance, hands: Candidates, shape: CloudObject) -> GraspSet:
    """The hands closed onto the solid, those that hold and whose approach is free, best first."""
    if not len(hands):
        return GraspSet.empty()
    closure = close(hands, sdf, steps=12)
    value = score(hands, closure, shape)
    order = np.argsort(-value, kind="stable")
    order = order[value[order] > 0][:APPROACHED]
    closed = hands.closed(closure.joints)[order]
    free = approach_is_free(closed, sdf, tolerance=0.001)
    grasps = closed[free].grasps
    if not len(grasps):
        return GraspSet.empty()
    reference = shape.points[cKDTree(shape.points).query(grasps.position)[1]]
    return replace(grasps, score=value[order][free], reference_point=reference)


def top_down_grasps(scene: Scene) -> GraspSet:
    """The best hands of every cluster of the cloud, frame *table*; the camera's position is not used."""
    with scene.clock("top_down"):
        return joined([grasps_of(shape) for shape in cloud_objects(scene.points)])

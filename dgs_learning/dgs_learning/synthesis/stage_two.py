"""Stage 2: grasps of single objects, kept in a scene only where hand and approach are free (paper, section V-B)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array, apply, inverse
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.synthesis.candidates import PALM
from dgs_learning.synthesis.closing import APPROACH
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.synthesis.sdf import SignedDistance

TABLE_CLEARANCE = 0.001
OBJECT_CLEARANCE = 0.001
"""Smallest distance of the hand to the table and to the other objects [m]."""
_BACK = np.arange(0.0, APPROACH + 1e-9, 0.02)
_RADII = HAND.all_radii
_PALM = PALM[::2]
_ALL_RADII = np.concatenate([_RADII, _RADII, np.zeros(len(_PALM))])
_OPEN = np.r_[: len(_RADII), 2 * len(_RADII) : len(_ALL_RADII)]
"""Of `hand_points`, those of the pre-grasp shape and the palm: what the approach moves."""


def hand_points(grasps: GraspSet) -> Array:
    """Points of the hand in `hand_tcp` that an approach must keep free.

    Returns:
        (G, P, 3) points [m]: the fingers' spheres in the pre-grasp and final shape and the palm; of radii `_ALL_RADII`.
    """
    shapes = [
        HAND.finger_spheres(joints).reshape(len(grasps), len(HAND.all_radii), 3)
        for joints in (grasps.pre_grasp_joints, grasps.grasp_joints)
    ]
    return np.concatenate([*shapes, np.broadcast_to(_PALM, (len(grasps), *_PALM.shape))], axis=1)


def valid_in_scene(
    scene: Scene, grasps: Sequence[GraspSet], sdfs: Sequence[SignedDistance]
) -> list[NDArray[np.int64]]:
    """Which grasps of every object of a scene stay feasible.

    The pre-grasp shape must be free along the whole 0.1 m approach, the final shape at the grasp, against the table
    and all other objects. (Against its own object the grasp was tested in stage 1.)

    Returns:
        per object the indices of its feasible grasps; `grasps` and `sdfs` are per object as well.
    """
    kept = []
    for i, (T_table_object, own) in enumerate(zip(scene.T_table_object, grasps, strict=True)):
        placed = own.moved(T_table_object)
        index = np.flatnonzero(placed.rotation[:, 2, 2] < 0.2)
        placed = placed[index]
        world = posed(hand_points(placed), placed.position, placed.rotation)
        lowest = (world[..., 2] - _ALL_RADII).min(1)
        # Backing off along an approach that does not come from above could still dip into the table.
        dip = np.maximum(APPROACH * placed.rotation[:, 2, 2], 0.0)
        above = lowest - dip > TABLE_CLEARANCE
        index, world, approach = index[above], world[above], placed.rotation[above, :, 2]
        others = [k for k in range(len(scene.objects)) if k != i]
        kept.append(index[_free_of(scene, others, sdfs, world, approach)])
    return kept


def _free_of(
    scene: Scene, others: Sequence[int], sdfs: Sequence[SignedDistance], world: Array, approach: Array
) -> NDArray[np.bool_]:
    """(G,) whether hands with points `world` (G, P, 3), moved back along `approach` (G, 3), clear other objects."""
    free = np.ones(len(world), dtype=bool)
    if not len(world):
        return free
    centre = (world.min(1) + world.max(1)) / 2
    reach = np.linalg.norm(world - centre[:, None], axis=-1).max(1) + APPROACH
    for k in others:
        T_object_table = inverse(scene.T_table_object[k])
        low, high = sdfs[k].box
        local_centre = apply(T_object_table, centre)
        gap = np.linalg.norm(local_centre - np.clip(local_centre, low, high), axis=1)
        index = np.flatnonzero(free & (gap < reach))
        local = apply(T_object_table, world[index])
        step = approach[index] @ T_object_table[:3, :3].T
        for back in _BACK:
            use = slice(None) if back == 0 else _OPEN
            points = local[:, use] - back * step[:, None]
            # Outside the grid a point is farther off than any radius and the clearance: see `MARGIN`.
            near = (points > low) & (points < high)  # three columns: .all(-1) over so few is slow
            hand, point = np.nonzero(near[..., 0] & near[..., 1] & near[..., 2])
            hit = sdfs[k](points[hand, point]) - _ALL_RADII[use][point] <= OBJECT_CLEARANCE
            clear = np.ones(len(index), dtype=bool)
            clear[hand[hit]] = False
            free[index[~clear]] = False
            index, local, step = index[clear], local[clear], step[clear]
    return free

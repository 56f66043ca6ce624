"""Moves candidates a little and closes their fingers onto the observed cloud.

Proposed poses are right to about a centimetre and proposed final joints are a mean over grasps; where the surfaces
are, the cloud knows better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_description.hand_ik import reach_with_balls
from dgs_grasp_planner.contact.closing import (
    ClosingPath,
    Mask,
    at_table,
    closed,
    closing_path,
    reach_below,
    touch,
)
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.contact.quality import NO_HOLD, Contacts, contacts

REACHED = 0.001
"""A ball that comes so near to where it is wanted gets there [m]."""
HELD_OFF = 0.003
"""Distance to the cloud that the final joints keep [m]: what it shows is not nearer to the truth, and the hand closes
until it feels something. The place is chosen for fingers that touch."""
MOVES = np.array([-0.010, -0.005, 0.0, 0.005, 0.010])
"""Along the TCP's x axis, across the object, and then along the approach [m]."""
LEANS = (-0.35, -0.175, 0.175, 0.35)
"""Turns about the TCP's y axis, for what would hang beside the hand [rad]."""
COST = 0.02
"""Quality that a move of 10 mm, or a lean, has to gain."""
_LOWER, _UPPER = HAND.split(HAND.lower), HAND.split(HAND.upper)


def fit(grasps: GraspSet, field: HeightField) -> GraspSet:
    """Candidates moved to where their contacts are best nearby, fingers closed onto the cloud, with their quality.

    A candidate that holds nothing anywhere nearby keeps its pose and joints. The pre-grasp opens as it did. One that
    moves before it closes stays as it is, quality included: a height field cannot judge it, for it goes beneath
    something or pushes.

    Args:
        grasps: candidates, frame *table*.
        field: what stands there, of which things that touch are judged one by one.
    """
    moving = grasps.motion.any(axis=1) & ~grasps.drags
    if moving.all():
        return grasps
    if moving.any():
        still_first = np.argsort(moving, kind="stable")
        return joined([fit(grasps[~moving], field), grasps[moving]])[still_first.argsort()]
    field, path = field.separated, closing_path(grasps)
    low = at_table(grasps.position, grasps.rotation, path.nodes[:, 2])
    position, rotation = _moved(path, grasps, low, field), grasps.rotation
    touched = closed(path, position, rotation, field)
    found = contacts(rotation, touched, path.active, field)
    leaning = _leaning(path, position, rotation, found, field)
    if leaning is not None:
        position, rotation = leaning
        touched = closed(path, position, rotation, field)
        found = contacts(rotation, touched, path.active, field)
    quality = found.quality()
    held = (quality > NO_HOLD)[:, None]
    final = path.joints(touched.held_off(HELD_OFF))
    way = HAND.split(grasps.pre_grasp_joints - grasps.grasp_joints)
    before = np.clip(final + way, _LOWER, _UPPER)
    if low.any():
        before[low], final[low] = _level(
            path.nodes[low], path.active[low], before[low], final[low], rotation[low, 2]
        )
    before = np.where(path.active[..., None], before, final)
    return replace(
        grasps,
        position=np.where(held, position, grasps.position),
        rotation=np.where(held[..., None], rotation, grasps.rotation),
        pre_grasp_joints=np.where(held, before.reshape(-1, HAND.joint_count), grasps.pre_grasp_joints),
        grasp_joints=np.where(held, final.reshape(-1, HAND.joint_count), grasps.grasp_joints),
        quality=quality,
    )


def _moved(path: ClosingPath, grasps: GraspSet, low: Mask, field: HeightField) -> Array:
    """(K, 3) the best places nearby: first across the object, then along the approach.

    A hand at the table (`low`) keeps its place: along its own axes, which lean, it would leave the height at which low
    things are had.
    """
    position, rotation = grasps.position, grasps.rotation
    axes = np.where(low[:, None, None], 0.0, rotation)
    for axis in (0, 2):
        tried = position[:, None] + MOVES[:, None] * axes[:, None, :, axis]
        tried = _above_table(path, tried, rotation)
        touched = touch(path, tried, rotation, field)
        turns, active = np.repeat(rotation, len(MOVES), axis=0), np.repeat(path.active, len(MOVES), axis=0)
        value = contacts(turns, touched, active, field).quality().reshape(len(grasps), -1)
        best = (value - COST * np.abs(MOVES) / 0.010).argmax(axis=1)
        position = tried[np.arange(len(grasps)), best]
    return position


def _leaning(
    path: ClosingPath,
    position: Array,
    rotation: Array,
    found: Contacts,
    field: HeightField,
) -> tuple[Array, Array] | None:
    """(K, 3) and (K, 3, 3) hands that lean, about the middle of the pinch, where what they hold would hang else; None
    where nothing would."""
    low = at_table(position, rotation, path.nodes[:, 2])
    rows = np.flatnonzero(found.enough & (found.sag > 0) & ~low)
    if not len(rows):
        return None
    few, middle = replace(path, nodes=path.nodes[rows], active=path.active[rows]), found.pinch.middle[rows]
    tried, value = [(position[rows], rotation[rows])], [found.quality()[rows]]
    for lean in LEANS:
        turned = rotation[rows] @ Rotation.from_euler("y", lean).as_matrix()
        local = rotation[rows].transpose(0, 2, 1) @ (position[rows] - middle)[..., None]
        there = _above_table(few, (middle + (turned @ local)[..., 0])[:, None], turned)
        tries = touch(few, there, turned, field)
        tried.append((there[:, 0], turned))
        value.append(contacts(turned, tries, few.active, field).quality() - COST)
    best, place = np.argmax(value, axis=0), np.arange(len(rows))
    position, rotation = position.copy(), rotation.copy()
    position[rows] = np.stack([each for each, _ in tried])[best, place]
    rotation[rows] = np.stack([each for _, each in tried])[best, place]
    return position, rotation


def _level(nodes: Array, active: Mask, before: Array, final: Array, up: Array) -> tuple[Array, Array]:
    """Pre-grasps and final joints (K, F, 4) whose end balls are as high as in the final shapes that were proposed; as
    they were where the fingers do not reach that far.

    Args:
        nodes: (K, M, F, 4) of the closing path, active: (K, F) its fingers.
        before, final: (K, F, 4) pre-grasps, and where the fingers touch.
        up: (K, 3) in `hand_tcp`.
    """

    def along(way: Array) -> Array:
        return np.asarray(way - (way * up[:, None]).sum(-1, keepdims=True) * up[:, None])

    opened, proposed, touched = (HAND.end_balls(shape) for shape in (nodes[:, 1], nodes[:, 2], final))
    touched = proposed + along(touched - proposed)
    wanted = np.stack([touched + along(opened - proposed), touched])
    level = reach_with_balls(HAND, wanted)
    off = np.linalg.norm(HAND.end_balls(level) - wanted, axis=-1).max(axis=0)
    reached = ((off < REACHED) | ~active).all(axis=1)[:, None, None]
    return np.where(reached, level[0], before), np.where(reached, level[1], final)


def _above_table(path: ClosingPath, position: Array, rotation: Array) -> Array:
    """(K, V, 3) positions, raised where pre-grasp or proposed final shape would cut the table."""
    raised = position.copy()
    raised[..., 2] = np.maximum(position[..., 2], reach_below(path.nodes[:, 1:3], rotation)[:, None])
    return raised

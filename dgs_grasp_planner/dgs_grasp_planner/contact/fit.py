"""Moves candidates a little, closes their fingers onto the observed cloud, and ranks them by what the fingers meet.

The network's poses are right to about a centimetre and its final joints are a mean over grasps; where the surfaces
are, the cloud knows better.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.grasp import NO_WISHES, GraspSet, PlanRequest
from dgs_description.hand_model import SPHERE_RADII, finger_spheres, pre_grasp
from dgs_grasp_planner.contact.closing import ClosingPath, closing_path, touch
from dgs_grasp_planner.contact.height_field import HeightField, height_field
from dgs_grasp_planner.contact.quality import UNHELD, evidence
from dgs_grasp_planner.propose.level_pinch import LevelPinchConfig, level_pinches

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RADII = np.tile(SPHERE_RADII, 10)
WAY = np.arange(0.01, 0.101, 0.01)
"""Places before the grasp where the pre-grasp shape is looked at [m]."""
PUSHES = 0.65
"""Factor of a hand that would cut something on its way."""


@dataclass(frozen=True)
class RefineConfig:
    """Which steps are taken and how far. Lengths in metres."""

    move: bool = True
    """Correct the hand's place."""
    close: bool = True
    """Close the fingers onto the cloud; else the joints are the network's."""
    rank: bool = True
    """Multiply the score by the quality of the contacts."""
    complete: bool = True
    """Guess hidden sides from symmetry."""
    candidates: int = 48
    """So many of the best are looked at, the rest is dropped."""
    sides: tuple[float, ...] = (-0.010, -0.005, 0.0, 0.005, 0.010)
    """Moves along the TCP's x axis, across the object."""
    depths: tuple[float, ...] = (-0.010, -0.005, 0.0, 0.005, 0.010)
    """Moves along the approach."""
    standoff: float = 0.001
    """Distance to the cloud that the final joints keep [m]; the place is chosen for fingers that touch."""
    cost: float = 0.02
    """Quality that a move of 10 mm has to gain."""
    level_pinch: LevelPinchConfig = field(default_factory=LevelPinchConfig)
    """Proposals for what is low and long."""


def way_is_free(grasps: GraspSet, field: HeightField) -> Array:
    """(N,) how likely the fingers push nothing aside on the straight way, in [`PUSHES`, 1].

    The clearance of the pre-grasp shape over the last `WAY` says it well: of 384 candidates on training objects that
    passed all checks, executed up to the grasp, 1 % pushed something by more than 10 mm where it was over 5 mm, 8 %
    where it was 0 to 5 mm, and 32 % where it was less.
    """
    spheres = finger_spheres(grasps.pre_grasp_joints).reshape(len(grasps), -1, 3)
    there = spheres @ grasps.rotation.transpose(0, 2, 1) + grasps.position[:, None]
    back = WAY[:, None] * grasps.rotation[:, None, :, 2]
    way = (there[:, None] - back[:, :, None]).astype(np.float32)
    clearance = field.clearance(way.reshape(len(grasps), len(WAY), 5, -1, 3)).min(axis=(1, 2, 3))
    return np.asarray(PUSHES + (1 - PUSHES) * np.clip((clearance + 0.002) / 0.007, 0, 1))


def refine(
    grasps: GraspSet,
    cloud: NDArray,
    camera: Array,
    config: RefineConfig = RefineConfig(),
    request: PlanRequest = NO_WISHES,
) -> GraspSet:
    """The best candidates moved to where the evidence is best nearby, their fingers closed onto the cloud.

    Level pinches are proposed beside them. A candidate that holds nothing anywhere nearby keeps its pose and joints.

    Args:
        grasps: candidates by falling score, frame *table*.
        cloud: (N, 3) [m], camera: (3,) its position [m], frame *table*.
        config: which steps are taken.
        request: what the caller wishes; only such things are proposed.

    Returns:
        candidates by falling score.
    """
    if not (config.move or config.close or config.rank):
        return grasps
    field = height_field(cloud, camera if config.complete else None)
    grasps = grasps.select(np.arange(min(len(grasps), config.candidates)))
    if field is None:
        return grasps
    grasps = grasps.joined(request.admitted(level_pinches(field, config.level_pinch)))
    if not len(grasps):
        return grasps
    opening = np.where(grasps.proposed, config.level_pinch.opening, np.inf)
    path = closing_path(grasps, opening)
    position = _moved(path, grasps, field, config) if config.move else grasps.position
    contact = touch(path, position[:, None], grasps.rotation, field, steps=21, halvings=3)
    quality = evidence(grasps.rotation, contact, path.active, field).quality()
    held = (quality > UNHELD)[:, None]
    position = np.where(held, position, grasps.position)
    refined = replace(grasps, position=position, offset=position - grasps.reference_point)
    if config.close:
        final = path.joints(contact.held_off(config.standoff))
        before = pre_grasp(final, path.active, opening)
        refined = replace(
            refined,
            pre_grasp_joints=np.where(held, before.reshape(-1, 20), grasps.pre_grasp_joints),
            grasp_joints=np.where(held, final.reshape(-1, 20), grasps.grasp_joints),
        )
    if config.rank:
        refined = replace(refined, score=grasps.score * quality * way_is_free(refined, field))
    refined = refined.select(~refined.proposed | held[:, 0])  # nothing but the evidence speaks for a proposal
    return refined.select(np.argsort(-refined.score, kind="stable"))


def _moved(path: ClosingPath, grasps: GraspSet, field: HeightField, config: RefineConfig) -> Array:
    """(K, 3) the best places nearby: first across the object, then along the approach."""
    position, rotation = grasps.position, grasps.rotation
    for axis, moves in ((0, config.sides), (2, config.depths)):
        steps = np.asarray(moves)
        tried = position[:, None] + steps[:, None] * rotation[:, None, :, axis]
        tried = _above_table(path, tried, rotation)
        contact = touch(path, tried, rotation, field)
        turns, active = np.repeat(rotation, len(steps), axis=0), np.repeat(path.active, len(steps), axis=0)
        value = evidence(turns, contact, active, field).quality().reshape(len(grasps), -1)
        best = (value - config.cost * np.abs(steps) / 0.010).argmax(axis=1)
        position = tried[np.arange(len(grasps)), best]
    return position


def _above_table(path: ClosingPath, position: Array, rotation: Array) -> Array:
    """(K, V, 3) positions, raised where pre-grasp or predicted final shape would cut the table."""
    spheres = finger_spheres(path.nodes[:, 1:3]).reshape(len(rotation), -1, 3)
    below = ((spheres * rotation[:, None, 2]).sum(axis=-1) - _RADII).min(axis=-1)
    raised = position.copy()
    raised[..., 2] = np.maximum(position[..., 2], -below[:, None])
    return raised

"""Proposes to drag what is low and long over the table's edge, in a level pinch, until an end of it sticks out.

A thin thing in a level pinch slips when it is lifted, for balls beside it press it down; dragged, the table carries it.
Pinched over the edge it holds.
"""

from __future__ import annotations

from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import NEAR, HeightField
from dgs_grasp_planner.propose import edge_pinch
from dgs_grasp_planner.propose.level_pinch import LEAST_SHARE, level_pinches
from dgs_grasp_planner.propose.level_stance import ACTIVE
from dgs_grasp_planner.propose.push import (
    PushSettings,
    Thing,
    along_the_edge,
    is_free,
    thing_to_move,
    towards_the_edge,
)
from dgs_grasp_planner.scene import Scene

PINCHES, WAYS = 4, 2
"""Per thing: pinches, those nearest to its middle, and ways that are free, of each."""
NARROW = 2 * (edge_pinch.BALANCE + edge_pinch.LEAST_OVERHANG)
"""What is broader sticks out far enough however it lies, and can be pushed [m]."""
SPARE = 0.008
"""So much farther than `edge_pinch.LEAST_OVERHANG` an end comes out: what lies along the edge is not dragged [m]."""
BEFORE, OFF = 0.05, 0.5
"""Of the score: more than a push, and less for every metre that the pinch is off the thing's middle."""


class Drag:
    """Proposes drags of low things towards the table's edge."""

    name = "drag"

    def __init__(self, settings: PushSettings = PushSettings()):
        """`settings`: where to, as of pushes."""
        self.settings = settings

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*; none where no edge is known."""
        return scene.once(self._found)

    def _found(self, scene: Scene) -> GraspSet:
        if scene.edge is None or not ACTIVE.any():
            return GraspSet.empty()
        with scene.clock(self.name):
            found = drags(scene.field.separated, scene.edge, self.settings)
            return found[scene.share_of_high(found.reference_point) > LEAST_SHARE]


def drags(field: HeightField, edge: float, settings: PushSettings = PushSettings()) -> GraspSet:
    """Candidates of everything that can be pinched level and sticks out far enough afterwards; frame *table*.

    Args:
        field: what stands there, things that touch apart.
        edge: the table is where x is larger [m].
        settings: where to.
    """
    pinches = level_pinches(field)
    owner = field.nearest(pinches.reference_point, NEAR)
    found = []
    for number in np.unique(owner[owner > 0]).tolist():
        shape = field.shapes[number]
        if shape.width > NARROW:
            continue
        thing = thing_to_move(field, shape, edge, settings)
        out = edge_pinch.LEAST_OVERHANG + SPARE
        if thing is None or shape.points[:, 0].min() - thing.needed > edge - out:
            continue
        mine = pinches[owner == number]
        off = np.linalg.norm(mine.reference_point[:, :2] - thing.middle, axis=1)
        for k in off.argsort(kind="stable")[:PINCHES]:
            found += _drags_of(field, thing, mine[[k]], OFF * off[k])
    return joined(found)


def _drags_of(field: HeightField, thing: Thing, pinch: GraspSet, less: float) -> list[GraspSet]:
    """The drags of one thing in one pinch; `less`: of their score."""
    hand = HAND.finger_spheres(pinch.pre_grasp_joints) @ pinch.rotation[0].T + pinch.position
    below: NDArray = hand.reshape(-1, 3) - np.outer(HAND.all_radii, (0.0, 0.0, 1.0))
    palm = HAND.palm_points() @ pinch.rotation[0].T + pinch.position
    moving = np.concatenate([thing.outline, below, palm])
    free = (
        way
        for way in chain(towards_the_edge(thing), along_the_edge(thing))
        if is_free(field, thing.others, moving, way.direction * way.length)
    )
    return [
        GraspSet.of(
            Drag.name,
            position=pinch.position,
            rotation=pinch.rotation,
            pre_grasp_joints=pinch.pre_grasp_joints,
            grasp_joints=pinch.grasp_joints,
            active_fingers=pinch.active_fingers[0],
            score=way.score + BEFORE - less,
            reference_point=[*thing.middle, thing.thickness],
            motion=way.length * way.direction,
            drags=True,
        )
        for way in islice(free, WAYS)
    ]

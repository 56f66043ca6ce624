"""Proposes pushes that part things which lie against one another, for where nothing better is left to do.

The hand finds no room between them, and what is seen as one shape is as wide as all of it. A thing that is told apart
is pushed aside, past the others, until there is a gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, product

import numpy as np
from scipy.ndimage import distance_transform_edt

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.contact.height_field import CELL, HeightField
from dgs_grasp_planner.contact.shape import Shape
from dgs_grasp_planner.propose.push import LEANS, PUSHING, Thing, Way, heights_beside, push_of
from dgs_grasp_planner.scene import Scene

# What is pushed aside, and how far. Lengths in metres, angles in radians.
WAYS = (0.05, 0.08, 0.12, 0.16)
"""The shortest is taken that leaves the gap."""
GAP = 0.025
"""Between a thing and all else in the end, ..."""
LEAST = 0.008
"""... or so much, with less score."""
GRAZING = 0.03
"""Share of the thing that may cross others on the way, for where one ends and the next begins is a guess."""
OUTWARDS = 0.015
"""The fingers push so far beside the thing's middle, away from the others: there is more room."""
TOWARDS = 0.15
"""Pushes end nearer to the workspace's middle than this, or than they begin: nothing is to fall off the table."""
TURNS = tuple(np.deg2rad(np.arange(0.0, 360.0, 22.5)).tolist())
PROPOSALS = 16
"""At most, of every shape."""
SCORE = 0.8
"""Less for a large one of the things, far from the middle, and with a lean."""
HEIGHT = 0.15
"""Of what is pushed, at most."""
BEHIND, APART = 0.015, 0.006
"""Between the fingers and the thing before; to other things, of what moves."""


class Part:
    """Proposes pushes of what lies against something else."""

    name = "part"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*."""
        return scene.once(self._found)

    def _found(self, scene: Scene) -> GraspSet:
        if not PUSHING:
            return GraspSet.empty()
        with scene.clock(self.name):
            return partings(scene.field)


def partings(field: HeightField) -> GraspSet:
    """Candidates of every shape that is several things; frame *table*."""
    found: list[GraspSet] = []
    for shape in field.shapes.values():
        best_first = sorted(_aside(field, shape), key=lambda push: -push[1].score)
        stances = product(best_first, LEANS)
        pushes = (push_of(field, thing, way, BEHIND, lean, APART) for (thing, way), lean in stances)
        found += islice((push for push in pushes if push is not None), PROPOSALS)
    grasps = joined(found)
    return replace(grasps, source=np.full(len(grasps), Part.name))


def _aside(field: HeightField, shape: Shape) -> Iterator[tuple[Thing, Way]]:
    """Pushes of the things of a shape past one another."""
    things, together = field.separated, shape.points
    numbers = np.unique(things.owner[tuple(shape.cells.T)]).tolist()
    for number in numbers if len(numbers) > 1 else ():
        part = things.shapes[number]
        points, thickness = part.points, float(part.heights.max())
        if thickness > HEIGHT:
            continue
        middle = points.mean(axis=0)
        away = middle - together.mean(axis=0)
        aim = middle + OUTWARDS * away / max(float(np.linalg.norm(away)), 1e-6)
        # Of the others only the hand keeps clear: the thing may graze them.
        others = heights_beside(things, part, APART)
        thing = Thing(points, np.zeros((0, 3)), aim, thickness, 0.0, others)
        room = distance_transform_edt((things.owner == 0) | (things.owner == number)).ravel() * CELL
        small = 1 - 0.5 * len(points) / len(together)
        for turn in TURNS:
            direction = np.array([np.cos(turn), np.sin(turn), 0.0])
            shortest = _shortest(things, points, room, direction)
            if shortest is not None:
                way, good = shortest
                yield thing, Way(direction, way, SCORE * small * good)


def _shortest(
    things: HeightField, points: Array, room: Array, direction: Array
) -> tuple[float, float] | None:
    """The shortest way that leaves a gap [m] and how good it is, in (0, 1]; None where there is none.

    Args:
        points: (N, 2) cells of the thing [m].
        room: (C,) from every cell of the field to what else there is [m].
        direction: (3,) unit vector.
    """
    middle, grazing = points.mean(axis=0), int(GRAZING * len(points))
    for way in WAYS:
        there = room[things.cells(points + way * direction[:2])]
        end = float(np.hypot(*(middle + way * direction[:2])))
        outside = end > max(float(np.hypot(*middle)), TOWARDS)
        if outside or (there == 0.0).mean() > GRAZING:
            return None
        gap = float(np.partition(there, grazing)[grazing])
        if gap >= (LEAST if way == WAYS[-1] else GAP):
            return way, (1 - min(end, 0.5)) * min(gap / GAP, 1.0)
    return None

"""Proposes pushes that part things which lie against one another, for where nothing better is left to do.

The hand finds no room between them, and what is seen as one shape is as wide as all of it. A thing that is told apart
is pushed aside, past the others, until there is a gap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, product

import numpy as np
from scipy.ndimage import distance_transform_edt

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.contact.height_field import CELL, HeightField
from dgs_grasp_planner.propose.push import PUSHING, PushSettings, Thing, heights_beside, push_of
from dgs_grasp_planner.scene import Scene

_Way = tuple[Thing, Array, float, float]
"""What is pushed, direction (3,), way [m] and score."""


@dataclass(frozen=True)
class PartSettings:
    """What is pushed aside, and how far. Lengths in metres, angles in radians."""

    ways: tuple[float, ...] = (0.05, 0.08, 0.12, 0.16)
    """The shortest is taken that leaves the gap."""
    gap: float = 0.025
    """Between a thing and all else in the end, ..."""
    least: float = 0.008
    """... or so much, with less score."""
    grazing: float = 0.03
    """Share of the thing that may cross others on the way, for where one ends and the next begins is a guess."""
    outwards: float = 0.015
    """The fingers push so far beside the thing's middle, away from the others: there is more room."""
    towards: float = 0.15
    """Pushes end nearer to the workspace's middle than this, or than they begin: nothing is to fall off the table."""
    turns: tuple[float, ...] = tuple(np.deg2rad(np.arange(0.0, 360.0, 22.5)).tolist())
    proposals: int = 16
    """At most, of every shape."""
    score: float = 0.8
    """Less for a large one of the things, far from the middle, and with a lean."""
    push: PushSettings = PushSettings(gaps=(0.015,), height=0.15, apart=0.006)


class Part:
    """Proposes pushes of what lies against something else."""

    name = "part"

    def __init__(self, settings: PartSettings = PartSettings()):
        """`settings`: what and how far."""
        self.settings = settings

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*."""
        if scene.field is None or not PUSHING:
            return GraspSet.empty()
        with scene.clock(self.name):
            return partings(scene.field, self.settings)


def partings(field: HeightField, settings: PartSettings = PartSettings()) -> GraspSet:
    """Candidates of every shape that is several things; frame *table*."""
    found: list[GraspSet] = []
    for shape in np.unique(field.owner[field.owner > 0]):
        ways = sorted(_aside(field, int(shape), settings), key=_worst)
        stances = product(ways, settings.push.gaps, settings.push.leans)
        pushes = (
            push_of(field, thing, direction, way, score, gap, lean, settings.push)
            for (thing, direction, way, score), gap, lean in stances
        )
        found += islice((push for push in pushes if push is not None), settings.proposals)
    grasps = joined(found)
    return replace(grasps, source=np.full(len(grasps), Part.name))


def _worst(way: _Way) -> float:
    return -way[-1]


def _aside(field: HeightField, shape: int, settings: PartSettings) -> Iterator[_Way]:
    """Pushes of the things of a shape past one another."""
    things, together = field.separated, field.middles(field.shape(shape))
    numbers = np.unique(things.owner[field.owner == shape])
    for number in numbers if len(numbers) > 1 else ():
        cells = things.shape(int(number))
        points, thickness = things.middles(cells), float(things.heights[tuple(cells.T)].max())
        if thickness > settings.push.height:
            continue
        middle = points.mean(axis=0)
        away = middle - together.mean(axis=0)
        aim = middle + settings.outwards * away / max(float(np.linalg.norm(away)), 1e-6)
        # Of the others only the hand keeps clear: the thing may graze them.
        others = heights_beside(things, int(number), settings.push)
        thing = Thing(points, points[:0], aim, thickness, 0.0, others)
        room = distance_transform_edt((things.owner == 0) | (things.owner == number)).ravel() * CELL
        small = 1 - 0.5 * len(points) / len(together)
        for turn in settings.turns:
            direction = np.array([np.cos(turn), np.sin(turn), 0.0])
            shortest = _shortest(things, points, room, direction, settings)
            if shortest is not None:
                way, good = shortest
                yield thing, direction, way, settings.score * small * good


def _shortest(
    things: HeightField, points: Array, room: Array, direction: Array, settings: PartSettings
) -> tuple[float, float] | None:
    """The shortest way that leaves a gap [m] and how good it is, in (0, 1]; None where there is none.

    Args:
        points: (N, 2) cells of the thing [m].
        room: (C,) from every cell of the field to what else there is [m].
        direction: (3,) unit vector.
    """
    middle, grazing = points.mean(axis=0), int(settings.grazing * len(points))
    for way in settings.ways:
        there = room[things.cells(points + way * direction[:2])]
        end = float(np.hypot(*(middle + way * direction[:2])))
        outside = end > max(float(np.hypot(*middle)), settings.towards)
        if outside or (there == 0.0).mean() > settings.grazing:
            return None
        gap = float(np.partition(there, grazing)[grazing])
        if gap >= (settings.least if way == settings.ways[-1] else settings.gap):
            return way, (1 - min(end, 0.5)) * min(gap / settings.gap, 1.0)
    return None

"""Proposes grasps for what lies flat, which the pre-grasp of equation (9) cannot reach.

Equation (9) straightens the fingers: their tips rise by 7 to 20 mm while they close, so that a hand whose pre-grasp
just clears the table closes above a thin stick. Besides, the thumb is 30 mm shorter than the fingers. A *level pinch*
leans the hand towards the thumb until the balls that end the fingers are at one height, before and at contact. Long
things are pinched at several places, broader ones across their middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import CELL, HeightField
from dgs_grasp_planner.contact.shape import Shape
from dgs_grasp_planner.propose.level_stance import ACTIVE, LEAN, hand_axes, level_stance
from dgs_grasp_planner.scene import Scene

_TURNS = np.deg2rad(np.arange(0.0, 180.0, 5.0))
_ACROSS = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=-1)
_LONG = 0.040
"""What is narrower is left to the pinches of long things [m]."""
LEAST_SHARE = 0.15
"""Of the points seen around a place must be higher than the table: noise makes strips of a dozen points among a
hundred."""

# Where level pinches are proposed and how the hand stands then. Lengths in metres, angles in radians.
PROPOSALS = 8
"""Places at most, two ways round each."""
HEIGHT = 0.040
"""Things that are higher here are left to the network."""
ELONGATION = 1.5
"""Ratio of length to width that makes a thing long, within `REACH`: no wider than 45 mm or so."""
REACH = 0.040
"""So far around a place the thing is looked at."""
SPACING = 0.024
"""Edge of the blocks of which each has one place at most; two places are half of it apart at least."""
LOOKS = 64
"""Blocks looked at, those in the middle of their shape first."""
ROOM = 0.009
"""Between the balls and the thing on either side before they close."""
BROADEST = 0.075
"""What is no longer than broad is pinched across its middle up to this width, with `BROAD_LEAN` and `BROAD_ROOM`:
the balls are level within 4 mm at contact then."""
BROAD_LEAN = float(np.deg2rad(25.0))
BROAD_ROOM = 0.006
CLEARANCE = 0.0005
"""Of the balls above the table: pressed onto it, straight fingers are stiff."""
SCORE = 0.9
"""Takes the place of the network's score."""


@dataclass(frozen=True)
class _Place:
    """A cross-section: its middle (2,), the thing's point nearest to it (2,), direction (2,) across it, width, and
    height there [m]; of a long thing?"""

    middle: Array
    point: Array
    across: Array
    width: float
    height: float
    long: bool = True


class LevelPinch:
    """Proposes pinches across what is low, the best places of every thing first."""

    name = "level_pinch"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*; none where nothing is low."""
        return scene.once(self._found)

    def _found(self, scene: Scene) -> GraspSet:
        if not ACTIVE.any():
            return GraspSet.empty()
        with scene.clock(self.name):
            grasps = level_pinches(scene.field.separated)
            return grasps[scene.share_of_high(grasps.reference_point) > LEAST_SHARE]


def level_pinches(field: HeightField) -> GraspSet:
    """Candidates, two ways round at each place; frame *table*."""
    places = _places(field) + _broad_places(field)
    if not places:
        return GraspSet.empty()
    across = np.array([[*place.across, 0.0] for place in places])
    top = np.array([[*place.middle, place.height] for place in places])
    leans = np.array([LEAN if place.long else BROAD_LEAN for place in places])
    rooms = [ROOM if place.long else BROAD_ROOM for place in places]
    stances = [level_stance(p.width, a, r) for p, a, r in zip(places, leans.tolist(), rooms, strict=True)]
    across, top, leans = (np.repeat(each, 2, axis=0) for each in (across, top, leans))
    stances = [stance for stance in stances for _ in range(2)]
    across[1::2] *= -1
    down = np.array([0.0, 0.0, -1.0])
    rotation = np.array([hand_axes(a, down, lean) for a, lean in zip(across, leans.tolist(), strict=True)])
    middle = np.array([stance.middle for stance in stances])
    position = top - (rotation @ middle[:, :, None])[:, :, 0]
    position[:, 2] += np.maximum(HAND.ball_radius + CLEARANCE, top[:, 2] / 2) - top[:, 2]
    return GraspSet.of(
        LevelPinch.name,
        position=position,
        rotation=rotation,
        pre_grasp_joints=np.array([stance.before.reshape(HAND.joint_count) for stance in stances]),
        grasp_joints=np.array([stance.final.reshape(HAND.joint_count) for stance in stances]),
        active_fingers=ACTIVE,
        score=np.full(len(across), SCORE),
        reference_point=np.repeat([[*p.point, p.height] for p in places], 2, axis=0),
    )


def _places(field: HeightField) -> list[_Place]:
    around = maximum_filter(field.heights, size=2 * int(2 * HAND.ball_radius / CELL) + 1)
    cells = np.argwhere((field.heights > 0) & (around < HEIGHT))  # where a fingertip has room
    if not len(cells):
        return []
    points = field.middles(cells)
    owner = field.owner[tuple(cells.T)]
    block = np.unique(
        np.column_stack([owner, np.floor(points / SPACING)]).astype(np.int64),
        axis=0,
        return_index=True,
    )[1]
    nearest_first = block[np.argsort(np.linalg.norm(points - field.centres[owner], axis=1)[block])]
    places: list[_Place] = []
    for row in nearest_first[:LOOKS]:
        place = _cross_section(field.shapes[int(owner[row])], points[row])
        if place is None:
            continue
        if all(np.linalg.norm(place.middle - other.middle) > SPACING / 2 for other in places):
            places.append(place)
            if len(places) == PROPOSALS:
                break
    return places


def _broad_places(field: HeightField) -> list[_Place]:
    """Across the middle of what is low, broader than a long thing, and narrow enough: its narrowest way, and square
    to it. What is forked there, such as pliers, is pinched from outside both prongs, narrow or broad."""
    places: list[_Place] = []
    for number, shape in field.shapes.items():
        if shape.thickness > HEIGHT:
            continue
        points = shape.points - field.centres[number]
        narrowest = np.ptp(points @ _ACROSS.T, axis=0).argmin()
        for across in (_ACROSS[narrowest], _ACROSS[narrowest - len(_ACROSS) // 2]):
            band = np.abs(points @ (-across[1], across[0])) < SPACING / 2
            if not band.any():
                continue
            low, high = np.quantile(points[band] @ across, (0.01, 0.99))
            width, middle = float(high - low) + CELL, across * (high + low) / 2
            away = np.linalg.norm(points - middle, axis=1)
            if (away.min() > CELL or width > _LONG) and width < BROADEST:
                height = float(np.median(shape.heights[band]))
                at, point = field.centres[number] + (middle, points[away.argmin()])
                places.append(_Place(at, point, across, width, height, long=width < _LONG))
    return places


def _cross_section(shape: Shape, at: Array) -> _Place | None:
    """Of a shape near `at` (2,) [m]; None where it is not low and long."""
    for _ in range(2):  # seen from its edge a broad thing looks long: look again from its middle
        near = np.linalg.norm(shape.points - at, axis=1) < REACH
        points, heights = shape.points[near], shape.heights[near]
        if len(points) < 6 or heights.max() > HEIGHT:
            return None
        values, vectors = np.linalg.eigh(np.cov(points.T))
        if values[1] < ELONGATION**2 * values[0]:
            return None
        across, along = vectors[:, 0], vectors[:, 1]
        sides = ((points - at) @ across)[np.abs((points - at) @ along) < SPACING / 2]
        if not len(sides):
            return None
        at = at + across * (sides.max() + sides.min()) / 2
    own = np.linalg.norm(points - at, axis=1)
    if own.min() > CELL:  # the middle of a hook or a ring is empty
        return None
    whole = shape.points - at
    if np.ptp((whole @ across)[np.abs(whole @ along) < SPACING / 2]) > HAND.grasp.widest:
        return None  # a broad thing of which strips are seen
    return _Place(at, at, across, float(np.ptp(sides)) + CELL, float(heights[own.argmin()]))

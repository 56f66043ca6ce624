"""Proposes pinches of what sticks out over the table's edge: thumb on top, fingers beneath, from outside the table.

Flat things wider than the hand offer it no two sides but top and bottom, and the bottom only where no table is. The
hand is that of a level pinch, turned so that the line between thumb and fingers is upright. It comes down outside of
the table and moves in level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.contact.shape import THICK, Shape, near_side
from dgs_grasp_planner.propose.level_stance import ACTIVE, LEAN, hand_axes, open_stance
from dgs_grasp_planner.scene import Scene

HAND_WIDTH = 0.10
"""Of the fingers side by side, fanned out [m]."""
_DISC = 0.007 * np.array([(0.0, 0.0), *((np.cos(a), np.sin(a)) for a in np.arange(6) * np.pi / 3)])
"""Where a ball touches a thing, more or less [m]."""
_STRAIGHT = HAND.split(HAND.open_hand)
"""The little finger is out of the way beneath: bent it would meet the thing before the others do."""

# Where edge pinches are proposed and how the hand stands then. Lengths in metres, angles in radians.
OVERHANG = 0.038
"""So much must stick out where the hand pinches ..."""
LEAST_OVERHANG = 0.018
"""... or so much of what cannot stick out farther, because its middle is ..."""
AT_THE_LIMIT = 0.02
"""... no more than so much above where it must stay (`balance`)."""
BALANCE, RAGGED = 0.015, 0.04
"""The middle of a thing stays so far above the table, and farther by so much times the share of its convex hull that it
does not fill: it stands on few places."""
HEIGHT = 0.075
"""Thicker things come less than 2 cm deep into the open hand."""
INSET = 0.045
"""Of the balls' centres into the overhang, less where the fingers beneath would come near to the table.

The nearer to the thing's middle, the less it turns in the hand: with friction 0.6 in MuJoCo, 24 mm held 11 of 18
cases, books, pouches and plates, 35 mm 17, 45 mm 18.
"""
RIM, RISE, SOLID = 0.012, 0.02, 0.85
"""What fills so much of its convex hull, and is higher by the second where the thumb lies than within the first of its
outline, may be hollow beneath: in a bowl that lies upside down fingers find no bottom."""
LEAST_INSET = 0.004
"""A thing 80 mm broad that lies along the edge cannot be had farther in: its middle has to stay on the table."""
GAP = 0.004
"""Between the fingers beneath and the table."""
FIRST = 0.002
"""The hand stands so much higher than the thing's middle: fingers that touch first from beneath do not tip it."""
RUN_UP = 0.025
"""Between the fingers and the thing where the approach ends and the motion begins."""
TURNS = tuple(np.deg2rad([0.0, 20.0, -20.0, 40.0, -40.0]).tolist())
"""From straight over the edge, about the vertical: an arm reaches only some."""
SPACING = 0.02
"""Between places along the edge."""
PROPOSALS = 3
"""Places at a thing at most, those nearest to its middle."""
SCORE, LESS = 0.95, 0.45
"""Takes the place of the network's score; less by up to half of the latter with a turn, off the thing's middle, not
deep inside (of the exam's 72 tries on new hardware 69 held, whatever they had of this), ..."""
HOLES = 0.5
"""... and by so much of it where the thumb, or two fingers, would miss the thing: what is ragged is pinched where most
of it is. Of some 390 tries at training things in both engines nine of ten held there, less than six of ten elsewhere.
"""
VESSEL = 0.5
"""Of the score where a vessel is pinched, its rim between the thumb and a curved bottom: of 15 own bowls six came into
the bin so, grasped by their rim from above all."""


class EdgePinch:
    """Proposes pinches of overhangs, those nearest to the middle of every thing."""

    name = "edge_pinch"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*; none where nothing sticks out or no edge is known."""
        if scene.edge is None or not ACTIVE.any():
            return GraspSet.empty()
        with scene.clock(self.name):
            return edge_pinches(scene.field, scene.edge)


def edge_pinches(field: HeightField, edge: float) -> GraspSet:
    """Candidates of every thing that sticks out; frame *table*.

    Args:
        field: what stands there.
        edge: the table is where x is larger [m].
    """
    found = []
    for shape in field.shapes.values():
        outside = shape.points[:, 0] < edge
        if outside.any() and not is_dome(shape):
            at_the_limit = shape.centre_of_mass[0] < edge + balance(shape) + AT_THE_LIMIT
            wanted = LEAST_OVERHANG if at_the_limit else OVERHANG
            found += _of_thing(
                _Overhang(field, shape, shape.points[outside], shape.heights[outside], edge, wanted)
            )
    return joined(found)


def balance(shape: Shape) -> float:
    """How far inside of the edge the middle of a thing must stay [m]."""
    return BALANCE + RAGGED * (1 - shape.solidity)


def is_dome(shape: Shape) -> bool:
    """Whether a thing rises from the edge's side as a bowl's bottom."""
    front = near_side(shape.points, np.array([1.0, 0.0]), shape.centre_of_mass, HAND.ball_radius)
    if front is None:
        return False
    heights, (ahead, aside) = shape.heights, (shape.points - shape.centre_of_mass).T
    ahead, beside = ahead - front, np.abs(aside) < HAND.ball_radius
    rim, top = beside & (ahead < RIM), beside & (np.abs(ahead - INSET) < RIM / 2)
    rises = rim.any() and top.any() and heights[top].max() - heights[rim].max() > RISE
    return bool(rises and shape.solidity > SOLID)


class _Overhang(NamedTuple):
    """What sticks out of one thing over the edge.

    Attributes:
        field: where the thing lies, shape: the whole of it.
        points: (N, 2) its cells beyond the edge [m], heights: (N,) of them [m].
        edge: the table is where x is larger [m].
        wanted: so much must stick out where the hand pinches [m].
    """

    field: HeightField
    shape: Shape
    points: Array
    heights: NDArray[np.float32]
    edge: float
    wanted: float

    def filled(self, balls: Array) -> Array:
        """(B,) how much of what balls at (B, 2) [m] would touch there is of the thing, 0..1."""
        owners = self.field.owner.ravel()[self.field.cells(balls[:, None] + _DISC)]
        return np.asarray((owners == self.shape.number).mean(axis=1))


def _of_thing(overhang: _Overhang) -> list[GraspSet]:
    """Pinches of one thing at the places nearest to its middle that have any."""
    middle = overhang.shape.centre_of_mass[1]
    away = np.unique(np.round((overhang.points[:, 1] - middle) / SPACING))
    found: list[list[GraspSet]] = []
    for step in away[np.abs(away).argsort()]:
        y = float(middle + step * SPACING)
        pinches = [_pinch(overhang, y, turn) for turn in TURNS]
        found.append([pinch for pinch in pinches if pinch is not None])
        if sum(map(bool, found)) == PROPOSALS:
            break
    return [pinch for pinches in found for pinch in pinches]


def _pinch(overhang: _Overhang, y: float, turn: float) -> GraspSet | None:
    """The pinch whose line lies at `y`, the hand ahead turned by `turn`; None where too little sticks out."""
    _, shape, points, heights, edge, wanted = overhang
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    outline = near_side(points, np.array([1.0, 0.0]), np.array([0.0, y]), HAND.ball_radius)
    if outline is None:
        return None
    thick = float(np.percentile(heights[np.abs(points[:, 1] - y) < HAND.ball_radius], THICK))
    if edge - outline < wanted or thick > HEIGHT:
        return None
    stance, depth = open_stance(thick, LEAN, INSET)
    axes = hand_axes(np.array([0.0, 0.0, 1.0]), ahead, LEAN)
    final = np.where(ACTIVE[:, None], stance.final, _STRAIGHT)
    shapes = np.stack([stance.before, final])
    # From the middle of the pinch, (F, S, 3) and (F, 3).
    hand, closed = (HAND.finger_spheres(shapes) - stance.middle) @ axes.T
    balls = (HAND.end_balls(final) - stance.middle) @ axes.T
    beneath = float((np.maximum(hand, closed)[1:, :, 0] + HAND.sphere_radii).max())
    inside = min(outline + min(INSET, depth) * ahead[0], edge - GAP - beneath)
    if inside - outline < LEAST_INSET:
        return None
    line = np.array([inside, y, thick / 2 + FIRST])
    from_line = points - line[:2]
    in_the_way = np.abs(from_line @ (-ahead[1], ahead[0])) < HAND_WIDTH / 2
    first = float((from_line @ ahead[:2])[in_the_way].min())
    way = float((hand @ ahead + HAND.sphere_radii).max()) - first + RUN_UP
    thumb, *fingers = overhang.filled(balls[ACTIVE, :2] + line[:2])
    holes = 1.0 - min(thumb, np.mean(sorted(fingers)[-2:]))  # beside a narrow thing one finger may miss it
    deep = min((inside - outline) / INSET, 1.0)
    off = abs(turn) / np.pi + abs(y - shape.centre_of_mass[1]) / (2 * HAND_WIDTH) + 0.3 * (1 - deep)
    return GraspSet.of(
        EdgePinch.name,
        position=line - axes @ stance.middle - way * ahead,
        rotation=axes,
        pre_grasp_joints=stance.before.reshape(HAND.joint_count),
        grasp_joints=final.reshape(HAND.joint_count),
        active_fingers=ACTIVE,
        score=(SCORE - LESS * min(off, 0.5)) * (1 - HOLES * holes) * (VESSEL if shape.vessel else 1.0),
        reference_point=[inside, y, thick],
        motion=way * ahead,
    )

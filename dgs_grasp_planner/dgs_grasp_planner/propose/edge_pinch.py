"""Proposes pinches of what sticks out over the table's edge: thumb on top, fingers beneath, from outside the table.

Flat things wider than the hand offer it no two sides but top and bottom, and the bottom only where no table is. The
hand is that of a level pinch, turned so that the line between thumb and fingers is upright. It comes down outside of
the table and moves in level.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import THICK, Floats, HeightField, near_side
from dgs_grasp_planner.propose.level_stance import ACTIVE, LEAN, hand_axes, level_stance
from dgs_grasp_planner.scene import Scene

HAND_WIDTH = 0.10
"""Of the fingers side by side, fanned out [m]."""
_STRAIGHT = HAND.split(HAND.open_hand)
"""The little finger is out of the way beneath: bent it would meet the thing before the others do."""

# Where edge pinches are proposed and how the hand stands then. Lengths in metres, angles in radians.
OVERHANG = 0.038
"""So much must stick out where the hand pinches ..."""
LEAST_OVERHANG = 0.018
"""... or so much of what cannot stick out farther ..."""
BALANCE = 0.035
"""... because its middle is so near to the edge."""
HEIGHT = 0.07
"""Thicker things are thicker than the hand opens."""
INSET = 0.045
"""Of the balls' centres into the overhang, less where the fingers beneath would come near to the table.

The nearer to the thing's middle, the less it turns in the hand: with friction 0.6 in MuJoCo, 24 mm held 11 of 18
cases, books, pouches and plates, 35 mm 17, 45 mm 18.
"""
LEAST_INSET = 0.008
GAP = 0.004
"""Between the fingers beneath and the table."""
ROOM = 0.009
"""Between the balls and the thing on either side before they close."""
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
SCORE = 0.9
"""Takes the place of the network's score; less with a turn, off the thing's middle, and not deep inside."""


class EdgePinch:
    """Proposes pinches of overhangs, those nearest to the middle of every thing."""

    name = "edge_pinch"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*; none where nothing sticks out or no edge is known."""
        if scene.field is None or scene.edge is None or not ACTIVE.any():
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
    for shape in np.unique(field.owner[field.owner > 0]):
        cells = field.shape(int(shape))
        points = field.middles(cells)
        outside = points[:, 0] < edge
        if outside.any():
            heights = field.heights[tuple(cells[outside].T)]
            middle = field.centre_of_mass(int(shape))
            found += _of_thing(_Overhang(points[outside], heights, middle, edge))
    return joined(found)


class _Overhang(NamedTuple):
    """Cells (N, 2) beyond the edge at x = `edge`, (N,) high, of a thing whose middle is at (2,) [m]."""

    points: Array
    heights: Floats
    middle: Array
    edge: float


def _of_thing(overhang: _Overhang) -> list[GraspSet]:
    """Pinches of one thing at the places nearest to its middle that have any."""
    away = np.unique(np.round((overhang.points[:, 1] - overhang.middle[1]) / SPACING))
    found: list[list[GraspSet]] = []
    for step in away[np.abs(away).argsort()]:
        y = float(overhang.middle[1] + step * SPACING)
        pinches = [_pinch(overhang, y, turn) for turn in TURNS]
        found.append([pinch for pinch in pinches if pinch is not None])
        if sum(map(bool, found)) == PROPOSALS:
            break
    return [pinch for pinches in found for pinch in pinches]


def _pinch(overhang: _Overhang, y: float, turn: float) -> GraspSet | None:
    """The pinch whose line lies at `y`, the hand ahead turned by `turn`; None where too little sticks out."""
    points, heights, middle, edge = overhang
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    outline = near_side(points, np.array([1.0, 0.0]), np.array([0.0, y]), HAND.ball_radius)
    if outline is None:
        return None
    thick = float(np.percentile(heights[np.abs(points[:, 1] - y) < HAND.ball_radius], THICK))
    at_the_limit = middle[0] < edge + BALANCE
    wanted = LEAST_OVERHANG if at_the_limit else OVERHANG
    if edge - outline < wanted or thick > HEIGHT:
        return None
    stance = level_stance(thick, LEAN, ROOM)
    axes = hand_axes(np.array([0.0, 0.0, 1.0]), ahead, LEAN)
    before, final = (np.where(ACTIVE[:, None], joints, _STRAIGHT) for joints in (stance.before, stance.final))
    hand = (HAND.finger_spheres(before) - stance.middle) @ axes.T  # (F, S, 3) from the middle of the pinch
    beneath = float((hand[1:, :, 0] + HAND.sphere_radii).max())
    inside = min(outline + INSET * ahead[0], edge - GAP - beneath)
    if inside - outline < LEAST_INSET:
        return None
    line = np.array([inside, y, thick / 2 + FIRST])
    from_line = points - line[:2]
    in_the_way = np.abs(from_line @ (-ahead[1], ahead[0])) < HAND_WIDTH / 2
    first = float((from_line @ ahead[:2])[in_the_way].min())
    way = float((hand @ ahead + HAND.sphere_radii).max()) - first + RUN_UP
    deep = min((inside - outline) / INSET, 1.0)
    off = abs(turn) / np.pi + abs(y - middle[1]) / (2 * HAND_WIDTH) + 0.3 * (1 - deep)
    return GraspSet.of(
        EdgePinch.name,
        position=line - axes @ stance.middle - way * ahead,
        rotation=axes,
        pre_grasp_joints=before.reshape(HAND.joint_count),
        grasp_joints=final.reshape(HAND.joint_count),
        active_fingers=ACTIVE,
        score=SCORE * max(1 - off, 0.5),
        reference_point=[inside, y, thick],
        motion=way * ahead,
    )

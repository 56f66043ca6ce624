"""Proposes to turn over what is too wide for the hand and offers nothing to pinch at the table's edge: domes.

A bowl that lies on its rim is such a thing. Where it sticks out, straight fingers come from outside beneath its rim,
then go up and over the table: it tips about the rim's far side. Upright, or on its side, it is grasped at its wall.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.contact.shape import Shape, near_side
from dgs_grasp_planner.propose.edge_pinch import is_dome
from dgs_grasp_planner.propose.level_stance import hand_axes
from dgs_grasp_planner.propose.push import heights_beside, is_free
from dgs_grasp_planner.scene import Scene

# How the hand stands and moves. Lengths in metres, angles in radians.
PITCHES = (0.0, -0.2)
"""The fingers point up so much, ..."""
TURNS = tuple(np.deg2rad([0.0, 10.0, -10.0, 20.0, -20.0]).tolist())
"""... and so much aside from straight over the edge: an arm reaches only some."""
INSET, LEAST_INSET = 0.045, 0.005
"""So far their ends come beneath the thing, or less where the table is near."""
RIM, GAP = 0.012, 0.005
"""So far from the outline the rim may stand, and so far beneath it the fingers stay."""
AHEAD, UP = 0.8, 1.2
"""The way of the fingers, times the thing's width."""
CLEAR = 0.004
"""Between the fingers' ends and the table's edge, on their way up past it."""
SCORE = 0.99
"""Less with a turn, but more than a push that would make more of it stick out."""


class TurnOver:
    """Proposes to turn over domes that stick out over the table's edge."""

    name = "turn_over"

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*, pushes; none where no dome sticks out or no edge is known."""
        if scene.edge is None:
            return GraspSet.empty()
        with scene.clock(self.name):
            return turns_over(scene.field, scene.edge)


def turns_over(field: HeightField, edge: float) -> GraspSet:
    """Candidates of every dome that sticks out; frame *table*.

    Args:
        field: what stands there.
        edge: the table is where x is larger [m].
    """
    found = []
    for shape in field.shapes.values():
        if shape.width > HAND.grasp.widest and is_dome(shape):
            others, standing = heights_beside(field, shape), np.insert(shape.points, 2, 0.0, axis=1)
            over = np.array([np.ptp(shape.points[:, 0]), 0.0, 0.0])
            if is_free(field, others, standing, over):
                found += [_turn_over(shape, edge, *how) for how in product(TURNS, PITCHES)]
    return joined([one for one in found if one is not None])


def _turn_over(shape: Shape, edge: float, turn: float, pitch: float) -> GraspSet | None:
    """The hand ahead turned by `turn` from straight over the edge, its fingers up by `pitch`; None where too little of
    the thing sticks out."""
    points, middle = shape.points, shape.centre_of_mass
    up = np.array([0.0, 0.0, 1.0])
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    side = np.cross(up, ahead)
    front = near_side(points, ahead[:2], middle, HAND.ball_radius)
    if front is None:
        return None
    width = float(np.ptp(points @ ahead[:2]))
    axes = Rotation.from_rotvec(-pitch * side).as_matrix() @ hand_axes(up, ahead, 0.0)
    fingers, radii = HAND.finger_spheres(HAND.open_hand)[1:] @ axes.T, HAND.sphere_radii
    rim = np.array([*(middle + front * ahead[:2]), 0.0]) - (fingers @ side).mean() * side
    reach = float((fingers @ ahead + radii).max())
    # The fingers' ends rise by their thickness while they go on to the edge.
    low = GAP + 2 * HAND.ball_radius - INSET * np.tan(pitch)
    beyond = float((rim[0] + fingers[..., 0] + radii).max()) - (edge - CLEAR - low * AHEAD / UP)
    back = max(reach - INSET, beyond / ahead[0])
    if reach - back < LEAST_INSET:
        return None
    beneath = fingers @ ahead - back < RIM
    place = rim - back * ahead - (GAP + (fingers[..., 2] + radii)[beneath].max()) * up
    return GraspSet.of(
        TurnOver.name,
        position=place,
        rotation=axes,
        pre_grasp_joints=HAND.open_hand,
        grasp_joints=HAND.open_hand,
        active_fingers=False,
        score=SCORE * (1 - abs(turn) / (4 * np.pi)),
        reference_point=[*middle, 0.0],
        motion=width * (AHEAD * ahead + UP * up),
    )

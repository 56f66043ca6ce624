"""When the robot is out of the camera's way: nothing of it is in the workspace or between workspace and camera."""

from __future__ import annotations

from functools import cache
from itertools import product

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.planning_scene import CARRIED, CollisionChecker, add_pairs, carried_shape
from dgs_arm_executor.robot_geometry import CHAIN, load_robot_geometry
from dgs_arm_executor.timing import Trajectory
from dgs_description.cell import CELL
from dgs_description.frames import Array
from dgs_description.hand import HAND

_OBJECTS = 0.15
"""What stands on the table is looked at up to this height [m]."""
_VIEW = "view"
_IN_VIEW = CHAIN[2:]
"""Foot and shoulder stand where they stand; the clouds are cut so that they do not count."""


def view_checker(hand_joints: ArrayLike, carried: CarriedBox | None = None) -> CollisionChecker:
    """`in_collision` of an arm posture says whether the camera sees the robot instead of the workspace.

    Args:
        hand_joints: (J,) [rad].
    """
    geometry = load_robot_geometry()
    arm, shapes = geometry.with_hand(hand_joints)
    parts = [*geometry.parts]
    for shape, place in _view_shapes():
        shapes.addGeometryObject(pin.GeometryObject(f"view{len(parts)}", 0, 0, place, shape))
        parts.append(_VIEW)
    seen = [*_IN_VIEW]
    if carried is not None:
        shapes.addGeometryObject(carried_shape(arm, carried))
        parts.append(CARRIED)
        seen.append(CARRIED)
    margins = add_pairs(shapes, parts, [(part, _VIEW, 0.0) for part in seen])
    return CollisionChecker(arm, shapes, parts, margins)


def seen_at_home() -> str:
    """Parts of the robot at home that clouds of the workspace show, as the planner would things; "" = none."""
    contacts = view_checker(HAND.open_hand).contacts(CELL.home)
    return ", ".join(sorted({part for pair in contacts for part in pair if part != _VIEW}))


def time_out_of_view(
    way: Trajectory, hand_joints: ArrayLike, left: ArrayLike, carried: CarriedBox | None = None
) -> float:
    """Time [s] from which on a way is out of the camera's way; infinite where the hand is not at its end.

    Args:
        hand_joints: (J,) that the hand has on the way [rad].
        left: (J,) that it is left with at the end [rad].
        carried: what it holds on the way.
    """
    if view_checker(left).in_collision(way.end):
        return np.inf
    checker = view_checker(hand_joints, carried)
    for k in range(len(way.times) - 1, -1, -1):
        if checker.in_collision(way.positions[k]):
            return float(way.times[k + 1]) if k + 1 < len(way.times) else np.inf
    return 0.0


@cache
def _view_shapes() -> tuple[tuple[coal.ShapeBase, pin.SE3], ...]:
    """The workspace as high as clouds are kept, and the camera's rays to it and to what sticks out over the edge."""
    low, high = CELL.workspace_bounds
    top = CELL.table_height + _OBJECTS
    beside = CELL.cloud_bounds[0][0], CELL.free_edge[0], low[2]
    boxes = (low, np.array([*high[:2], top])), (np.array(beside), np.array([low[0], CELL.free_edge[1], top]))
    here = pin.SE3.Identity()
    whole = coal.Box(*(high - low)), pin.SE3(np.eye(3), (low + high) / 2)
    return whole, *((_rays(*box), here) for box in boxes)


def _rays(low: Array, high: Array) -> coal.ConvexBase:
    """Hull of the camera and a box with corners (3,) in `base_link` [m]."""
    points = coal.StdVec_Vec3s()
    points.append(CELL.T_base_camera_optical[:3, 3])
    for corner in product(*zip(low, high, strict=True)):
        points.append(np.array(corner))
    return coal.Convex.convexHull(points, True, "Qt")

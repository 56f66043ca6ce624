"""Takes the robot's own surface out of a cloud, for clouds that were taken while the arm was in view."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.robot_geometry import ENVIRONMENT, load_robot_geometry, model_order
from dgs_description.arm_model import forward_kinematics
from dgs_description.frames import Array

_PADDING = 0.02
"""For noise of the cloud and error of the camera's pose [m]."""


def without_robot(
    points: ArrayLike, q: ArrayLike, hand_joints: ArrayLike, carried: CarriedBox | None = None
) -> Array:
    """Those of (N, 3) points in `base_link` [m] that are farther than `_PADDING` from every link of arm and hand.

    The joints, (6,) and (J,) [rad], are those of the moment when the cloud was taken. What is carried goes, too.
    """
    geometry = load_robot_geometry()
    arm, shapes = geometry.with_hand(hand_joints)
    placements = shapes.createData()
    state = np.asarray(q, float)[model_order(arm)]
    pin.updateGeometryPlacements(arm, arm.createData(), shapes, placements, state)
    cloud = np.asarray(points, dtype=np.float64)
    outside = np.ones(len(cloud), dtype=bool)
    links = [
        (shapes.geometryObjects[k].geometry, placements.oMg[k])
        for k, part in enumerate(geometry.parts)
        if part not in ENVIRONMENT
    ]
    middles, reach = map(np.array, zip(*(_ball(*link) for link in links), strict=True))
    low, high = middles - reach[:, None], middles + reach[:, None]
    # Nearly all points are far from the robot: the exact distance is for those near a link only.
    rows = np.flatnonzero(_between(cloud, low.min(axis=0), high.max(axis=0)))
    for (shape, placement), lower, upper in zip(links, low, high, strict=True):
        near = rows[_between(cloud[rows], lower, upper)]
        T_shape_base = placement.inverse()
        local = cloud[near] @ T_shape_base.rotation.T + T_shape_base.translation
        outside[near] &= _distance(shape, local) > _PADDING
    if carried is not None:
        outside &= ~carried.holds(cloud, forward_kinematics(q) @ T_TOOL0_TCP, _PADDING)
    return cloud[outside]


def _ball(shape: coal.ShapeBase, placement: pin.SE3) -> tuple[Array, float]:
    """Middle (3,) and radius of a ball around a placed shape and its padding [m]."""
    shape.computeLocalAABB()
    return placement.act(shape.aabb_center), shape.aabb_radius + _PADDING


def _between(points: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    """(N,) which points (N, 3) lie in a box."""
    return np.asarray(((points >= low) & (points <= high)).all(axis=1))


def _distance(shape: coal.ShapeBase, points: Array) -> Array:
    """(N,) distance of points in the shape's frame from it, 0 inside [m]."""
    if isinstance(shape, coal.Box):
        return np.linalg.norm(np.maximum(np.abs(points) - shape.halfSide, 0.0), axis=1)
    axial = np.maximum(np.abs(points[:, 2]) - shape.halfLength, 0.0)
    radial = np.hypot(points[:, 0], points[:, 1])
    if isinstance(shape, coal.Capsule):
        return np.maximum(np.hypot(radial, axial) - shape.radius, 0.0)
    return np.hypot(np.maximum(radial - shape.radius, 0.0), axial)

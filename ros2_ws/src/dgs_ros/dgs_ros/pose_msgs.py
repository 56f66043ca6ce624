"""geometry_msgs poses, points, vectors and transforms <-> numpy."""

from __future__ import annotations

import math

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Transform, TransformStamped, Vector3
from numpy.typing import ArrayLike
from std_msgs.msg import Header

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, from_quaternion, to_quaternion

_NORM_TOLERANCE = 1e-2


def pose_to_matrix(msg: Pose) -> Array:
    """(4, 4) transform of a pose [m]. Raises DgsError POSE_INVALID: not finite, or no unit quaternion."""
    return _matrix(msg.position, msg.orientation)


def transform_to_matrix(msg: Transform) -> Array:
    """(4, 4) matrix T_parent_child of a transform [m]; errors as in `pose_to_matrix`."""
    return _matrix(msg.translation, msg.rotation)


def matrix_to_pose(T_a_b: Array) -> Pose:
    """Pose of b in a of a (4, 4) transform [m]."""
    position, quaternion = to_quaternion(T_a_b)
    return Pose(position=to_point(position), orientation=_to_quaternion(quaternion))


def matrix_to_transform(
    T_parent_child: Array, parent: str, child: str, stamp: Time | None = None
) -> TransformStamped:
    """Stamped transform for /tf and /tf_static of a (4, 4) matrix [m]."""
    position, quaternion = to_quaternion(T_parent_child)
    return TransformStamped(
        header=Header(frame_id=parent, stamp=Time() if stamp is None else stamp),
        child_frame_id=child,
        transform=Transform(translation=to_vector3(position), rotation=_to_quaternion(quaternion)),
    )


def to_array(msg: Point | Vector3) -> Array:
    """(3,) of a point or vector."""
    return np.array([msg.x, msg.y, msg.z], dtype=np.float64)


def to_point(values: ArrayLike) -> Point:
    """Point of (3,) [m]."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return Point(x=x, y=y, z=z)


def to_vector3(values: ArrayLike) -> Vector3:
    """Vector of (3,)."""
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return Vector3(x=x, y=y, z=z)


def _to_quaternion(xyzw: Array) -> Quaternion:
    x, y, z, w = xyzw.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _matrix(position: Point | Vector3, rotation: Quaternion) -> Array:
    xyz = to_array(position)
    xyzw = np.array([rotation.x, rotation.y, rotation.z, rotation.w], dtype=np.float64)
    if not (np.isfinite(xyz).all() and np.isfinite(xyzw).all()):
        wrong = f"position {xyz.tolist()} or quaternion {xyzw.tolist()} is not finite"
        raise DgsError(ErrorCode.POSE_INVALID, wrong)
    norm = math.hypot(*xyzw.tolist())
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        wrong = f"quaternion {xyzw.tolist()} has length {norm:.4g}; it must be a unit quaternion"
        raise DgsError(ErrorCode.POSE_INVALID, wrong)
    return from_quaternion(xyz, xyzw)

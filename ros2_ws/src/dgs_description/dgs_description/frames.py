"""Frame names, and rigid transforms as 4x4 matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

BASE_LINK = "base_link"
TOOL0 = "tool0"
HAND_BASE = "hand_base"
HAND_TCP = "hand_tcp"
CAMERA_LINK = "camera_link"
CAMERA_OPTICAL = "camera_depth_optical_frame"

Array = NDArray[np.float64]

T_CAMERA_LINK_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Pose of the optical frame (x right, y down, z forward) in `camera_link` (x forward, y left, z up)."""

OBJECT_HEIGHT = 0.008
"""What is higher above the table than this is not the table.

Above the noise of a D455 at the cell's 1 m, whose standard deviation is 2.4 mm (0.1 px of disparity), and below the
thinnest things that a hand can grasp [m].
"""


def transform(
    rotation: ArrayLike = ((1, 0, 0), (0, 1, 0), (0, 0, 1)), position: ArrayLike = (0, 0, 0)
) -> Array:
    """(..., 4, 4) homogeneous matrices of (..., 3, 3) rotations and (..., 3) positions [m]."""
    turn, shift = np.asarray(rotation, np.float64), np.asarray(position, np.float64)
    matrix = np.zeros((*np.broadcast_shapes(turn.shape[:-2], shift.shape[:-1]), 4, 4))
    matrix[..., :3, :3], matrix[..., :3, 3], matrix[..., 3, 3] = turn, shift, 1.0
    return matrix


def inverse(T_a_b: Array) -> Array:
    """T_b_a of a (..., 4, 4) rigid transform T_a_b."""
    out = np.zeros_like(T_a_b)
    rotation_t = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation_t
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", rotation_t, T_a_b[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def apply(T_a_b: Array, points_b: Array) -> Array:
    """Points (N, 3) of frame b in frame a [m]."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def from_quaternion(position: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """(4, 4) matrix of a position [m] and a unit quaternion xyzw."""
    return transform(Rotation.from_quat(np.asarray(quaternion_xyzw, float)).as_matrix(), position)


def to_quaternion(T_a_b: Array) -> tuple[Array, Array]:
    """Position (3,) [m] and unit quaternion xyzw (4,) of a (4, 4) matrix."""
    return T_a_b[:3, 3].copy(), Rotation.from_matrix(T_a_b[:3, :3]).as_quat()


def from_rpy(position: ArrayLike, rpy: ArrayLike) -> Array:
    """(4, 4) matrix of URDF's xyz [m] and fixed-axis roll, pitch, yaw [rad]."""
    return transform(Rotation.from_euler("xyz", np.asarray(rpy, float)).as_matrix(), position)


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0, 0, 1)) -> Array:
    """Pose of an optical frame (x right, y down, z forward) at `eye` that looks at `target`, (4, 4)."""
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, np.asarray(up, float))
    right /= np.linalg.norm(right)
    return transform(np.column_stack([right, np.cross(forward, right), forward]), eye)

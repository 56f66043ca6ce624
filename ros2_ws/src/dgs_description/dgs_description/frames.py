"""Frame names, rigid transforms as 4x4 matrices, and where the parts of the cell stand (all in `base_link`)."""

from __future__ import annotations

from dataclasses import dataclass

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


OVERHANG = 0.08
"""What sticks out over the table's edge is looked at so far [m]."""
BEYOND = 0.10
"""What reaches out of the workspace, but not towards the robot, is looked at so far [m]."""


@dataclass(frozen=True)
class Cell:
    """Where table, workspace, bin and camera stand in `base_link` [m].

    The robot stands on a pedestal at the long side of the table.
    """

    table_height: float = -0.20
    """z of the table top: the base stands this far above it (see docs/cell.md for the reach scan)."""
    table_size: tuple[float, float, float] = (0.70, 1.10, 0.04)
    """x, y extent and thickness of the table top."""
    table_centre: tuple[float, float] = (0.38, 0.0)
    free_edge: tuple[float, float] = (0.12, 0.40)
    """y where the edge beside the robot is free: the arm reaches beyond it, and nothing of it is seen there [m]."""
    turning_edge: tuple[float, float] = (0.29, 0.35)
    """y where the arm also turns over what sticks out: nearer it meets itself, farther it does not reach [m]."""
    workspace_size: tuple[float, float] = (0.40, 0.80)
    """x, y extent of the area that is cleared."""
    workspace_centre: tuple[float, float] = (0.30, 0.0)
    workspace_height: float = 0.30
    """How far above the table points are kept."""
    floor_height: float = -0.92
    """z of the floor: beneath what sticks out over the table's edge there is room for a hand."""
    pedestal_radius: float = 0.064
    bin_size: tuple[float, float, float] = (0.30, 0.24, 0.15)
    """Outer x, y, z of the open box that takes the objects."""
    bin_centre: tuple[float, float] = (-0.10, -0.42)
    bin_wall: float = 0.006
    camera_distance: float = 1.0
    camera_elevation: float = float(np.deg2rad(62.0))
    """Elevation of the camera above the table plane, seen from the workspace centre [rad]."""

    @property
    def T_base_table(self) -> Array:
        """Frame `table`: origin in the workspace centre on the table top, axes as `base_link`."""
        return transform(position=(*self.workspace_centre, self.table_height))

    @property
    def T_base_camera_optical(self) -> Array:
        """Nominal pose of the depth camera: in front of the robot, looking back at the workspace centre."""
        centre = self.T_base_table[:3, 3]
        direction = np.array([np.cos(self.camera_elevation), 0.0, np.sin(self.camera_elevation)])
        return look_at(centre + self.camera_distance * direction, centre)

    @property
    def table_edge(self) -> float:
        """x of the table's edge beside the robot, in `base_link` [m]."""
        return self.table_centre[0] - self.table_size[0] / 2

    @property
    def workspace_bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner (3,) of the workspace box in `base_link` [m]."""
        centre, half = np.array(self.workspace_centre), np.array(self.workspace_size) / 2
        return (
            np.array([*(centre - half), self.table_height - 0.02]),
            np.array([*(centre + half), self.table_height + self.workspace_height]),
        )

    @property
    def cloud_bounds(self) -> tuple[Array, Array]:
        """The same of the box that clouds are cut to: beyond the table's edge, and as far as things reach out [m]."""
        low, high = self.workspace_bounds
        return np.array([self.table_edge - OVERHANG, low[1] - BEYOND, low[2]]), high + (BEYOND, BEYOND, 0.0)


CELL = Cell()

HOME_ARM = np.deg2rad([-100.0, -110.0, 100.0, -80.0, -90.0, 0.0])
"""Arm joints at home [rad]: hand beside the bin, no part of the arm between camera and workspace."""

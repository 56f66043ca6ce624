"""Straight lines of the TCP, tracked on one branch of the inverse kinematics without jumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from dgs_arm_executor.ik import T_TCP_TOOL0, T_TOOL0_TCP, ArmIK
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.joints import ARM_LOWER, ARM_UPPER

STEP = 0.005
"""Distance between two solved poses of a line [m]."""
ANGLE_STEP = np.deg2rad(2.0)
MAX_JOINT_STEP = 0.20
"""Largest joint step between two solved poses [rad]; more means a singularity or another branch."""
MAX_DEVIATION, MAX_TILT = 1e-3, np.deg2rad(0.5)
"""How far the motion between the solved poses may leave the line [m], [rad]."""
_ROTATION_RADIUS = 0.1
"""Turning by 1 rad counts as this much way [m], so that a line that only turns has a length."""


@dataclass(frozen=True)
class CartesianLine:
    """A tracked line.

    Attributes:
        joints: (N, 6) solved states from start to end [rad].
        arc: (N,) way of the TCP from the start [m].
        T_base_tcp: (N, 4, 4) poses at those states.
    """

    joints: Array
    arc: Array
    T_base_tcp: Array

    def reversed(self) -> CartesianLine:
        """The same line driven backwards."""
        return CartesianLine(self.joints[::-1], self.arc[-1] - self.arc[::-1], self.T_base_tcp[::-1])

    def smooth(self) -> SmoothPath:
        """Joint path for timing; its parameter is the TCP's way [m]."""
        return SmoothPath.through(self.joints, self.arc)


def line_poses(T_base_start: Array, T_base_end: Array, share: Array) -> Array:
    """(N, 4, 4) poses at (N,) shares of a straight line with an even turn."""
    shift = T_base_end[:3, 3] - T_base_start[:3, 3]
    ends = Rotation.from_matrix(np.stack([T_base_start[:3, :3], T_base_end[:3, :3]]))
    return transform(Slerp([0, 1], ends)(share).as_matrix(), T_base_start[:3, 3] + share[:, None] * shift)


def track_line(ik: ArmIK, T_base_start: Array, T_base_end: Array, q_start: ArrayLike) -> CartesianLine:
    """Follow a straight line of the TCP from a state that stands at its start.

    Args:
        T_base_start, T_base_end: (4, 4) poses of `hand_tcp`.
        q_start: (6,) joints at the start [rad]; their branch and turns are kept.

    Raises:
        DgsError: OUT_OF_REACH where the line leaves the reach; IK_FAILED where it passes a singularity or deviates;
            JOINT_LIMIT where a joint would leave its limits.
    """
    way = float(np.linalg.norm(T_base_end[:3, 3] - T_base_start[:3, 3]))
    angle = Rotation.from_matrix(T_base_start[:3, :3].T @ T_base_end[:3, :3]).magnitude()
    share = np.linspace(0.0, 1.0, int(max(3, np.ceil(way / STEP), np.ceil(angle / ANGLE_STEP))) + 1)
    arc = share * max(float(np.hypot(way, _ROTATION_RADIUS * angle)), 1e-9)
    poses = line_poses(T_base_start, T_base_end, share)
    options = ik.branches(poses @ T_TCP_TOOL0, wrist_3=float(np.asarray(q_start)[5]))
    joints = np.empty((len(poses), 6))
    joints[0] = q_start
    for n in range(1, len(poses)):
        joints[n] = _follow(options[n], joints[n - 1], arc[n])
    line = CartesianLine(joints, arc, poses)
    distance, tilt = deviation(ik, line)
    if distance > MAX_DEVIATION or tilt > MAX_TILT:
        off = f"{distance * 1e3:.2f} mm, {np.rad2deg(tilt):.2f} deg"
        raise DgsError(ErrorCode.IK_FAILED, f"the motion leaves the straight line by {off}")
    return line


def _follow(options: Array, previous: Array, way: float) -> Array:
    """The solution (6,) next to the previous state."""
    free = options + 2 * np.pi * np.round((previous - options) / (2 * np.pi))
    distance = np.abs(free - previous).max(1)
    after = f"after {way * 100:.1f} cm"
    if np.isnan(distance).all():
        raise DgsError(ErrorCode.OUT_OF_REACH, f"the straight line leaves the arm's reach {after}")
    best = int(np.nanargmin(distance))
    if distance[best] > MAX_JOINT_STEP:
        met = f"the straight line meets a singularity or the end of the reach {after}"
        raise DgsError(ErrorCode.IK_FAILED, f"{met}: a joint would jump by {distance[best]:.2f} rad")
    if (free[best] < ARM_LOWER).any() or (free[best] > ARM_UPPER).any():
        joint = int(np.argmax(np.maximum(ARM_LOWER - free[best], free[best] - ARM_UPPER)))
        end = f"joint {joint + 1} reaches its limit {after} of the straight line"
        raise DgsError(ErrorCode.JOINT_LIMIT, end)
    return free[best]


def deviation(ik: ArmIK, line: CartesianLine) -> tuple[float, float]:
    """Largest distance [m] and tilt [rad] of the smooth motion from the line, between the solved poses."""
    middle = (line.arc[:-1] + line.arc[1:]) / 2
    T_base_tcp = ik.forward_many(line.smooth()(middle)) @ T_TOOL0_TCP
    start, end = line.T_base_tcp[[0, -1]]
    wanted = line_poses(start, end, middle / line.arc[-1])
    way = end[:3, 3] - start[:3, 3]
    direction = way / max(float(np.linalg.norm(way)), 1e-12)
    offset = (T_base_tcp - wanted)[:, :3, 3]
    offset -= (offset @ direction)[:, None] * direction
    turn = np.swapaxes(wanted[:, :3, :3], 1, 2) @ T_base_tcp[:, :3, :3]
    return float(np.linalg.norm(offset, axis=1).max()), float(Rotation.from_matrix(turn).magnitude().max())

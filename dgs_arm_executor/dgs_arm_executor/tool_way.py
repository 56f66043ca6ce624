"""The tool's part in how long a motion takes: its speed is limited, whatever the joints could do."""

from __future__ import annotations

import numpy as np

from dgs_arm_executor.ik import T_TOOL0_TCP, ArmIK
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_description.frames import Array
from dgs_description.joints import ARM_ACCELERATION, ARM_VELOCITY, TOOL_SPEED

_LINE_SAMPLES, _PATH_SAMPLES = 9, 60
"""States at which the TCP is looked at: for an estimate, and for its speed."""


def least_times(ik: ArmIK, start: Array, states: Array) -> Array:
    """(K,) how long the straight joint lines from (6,) to (K, 6) [rad] take at least, by joints and by tool [s]."""
    turn, v, a = np.abs(states - start), ARM_VELOCITY, ARM_ACCELERATION
    joints = np.where(turn < v**2 / a, 2 * np.sqrt(turn / a), turn / v + v / a).max(axis=-1)
    share = np.linspace(0.0, 1.0, _LINE_SAMPLES)[:, None]
    lines = start + share * (states[:, None] - start)
    return np.maximum(joints, _steps(ik, lines).sum(axis=-1) / TOOL_SPEED)


def time_free_path(ik: ArmIK, path: SmoothPath, share: float) -> Trajectory:
    """As `time_path` along a joint path, the TCP no faster than `TOOL_SPEED`."""
    step = path.length / _PATH_SAMPLES
    fastest = _steps(ik, path(np.linspace(0.0, path.length, _PATH_SAMPLES + 1))).max()
    return time_path(path, share, max_path_speed=TOOL_SPEED * step / max(float(fastest), 1e-9) + 1e-9)


def _steps(ik: ArmIK, joints: Array) -> Array:
    """(..., N - 1) way of the TCP from each of (..., N, 6) states to the next [m]."""
    places = (ik.forward_many(joints.reshape(-1, 6)) @ T_TOOL0_TCP)[:, :3, 3]
    return np.linalg.norm(np.diff(places.reshape(*joints.shape[:-1], 3), axis=-2), axis=-1)

"""trajectory_msgs/JointTrajectory <-> numpy, by joint name, and durations <-> seconds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.joints import JointPath, reorder


def seconds(duration: Duration | Time) -> float:
    """Seconds of a duration or time stamp."""
    return float(duration.sec + duration.nanosec * 1e-9)


def to_duration(value: float) -> Duration:
    """Duration of a number of seconds, rounded to nanoseconds."""
    sec, nanosec = divmod(round(value * 1e9), 1_000_000_000)
    return Duration(sec=sec, nanosec=nanosec)


def to_time(value: float) -> Time:
    """Time stamp of a number of seconds, rounded to nanoseconds."""
    duration = to_duration(value)
    return Time(sec=duration.sec, nanosec=duration.nanosec)


def path_to_trajectory(names: Sequence[str], path: JointPath) -> JointTrajectory:
    """A trajectory message of N joints that starts at once (its stamp is zero).

    Raises:
        DgsError: TRAJECTORY_REJECTED if shapes do not fit, times do not increase or a number is not finite.
    """
    _check(path, len(names))
    nothing: list[list[float]] = [[]] * len(path.times)
    columns = (nothing if values is None else values.tolist() for values in path)
    points = [
        JointTrajectoryPoint(positions=q, velocities=dq, accelerations=ddq, time_from_start=to_duration(t))
        for t, q, dq, ddq in zip(*columns, strict=True)
    ]
    return JointTrajectory(joint_names=list(names), points=points)


def trajectory_to_path(msg: JointTrajectory, wanted: Sequence[str]) -> JointPath:
    """The path of the wanted joints, columns in the wanted order.

    Raises:
        JointNameError: the message does not name exactly the wanted joints.
        DgsError: TRAJECTORY_REJECTED if it has no points, points of the wrong length, velocities or accelerations in
            only some points, times that do not increase, or numbers that are not finite.
    """
    order = reorder(msg.joint_names, list(range(len(msg.joint_names))), wanted).astype(int)
    if len(msg.joint_names) != len(wanted):
        extra = ", ".join(sorted(set(msg.joint_names) - set(wanted)))
        raise _refuse(f"it moves joints that are not there: {extra}")
    if not msg.points:
        raise _refuse("it has no points")
    times = np.array([seconds(point.time_from_start) for point in msg.points])
    positions = _column(msg, "positions", order)
    if positions is None:
        raise _refuse("its points have no positions")
    velocities, accelerations = (_column(msg, kind, order) for kind in ("velocities", "accelerations"))
    path = JointPath(times, positions, velocities, accelerations)
    _check(path, len(wanted))
    return path


def _column(msg: JointTrajectory, kind: str, order: NDArray[np.int_]) -> Array | None:
    rows = [getattr(point, kind) for point in msg.points]
    lengths = {len(row) for row in rows}
    if lengths == {0}:
        return None
    if lengths != {len(order)}:
        raise _refuse(f"its points have {sorted(lengths)} {kind} for {len(order)} joints")
    return np.array(rows, dtype=np.float64)[:, order]


def _check(path: JointPath, joints: int) -> None:
    times = np.asarray(path.times)
    if times.ndim != 1 or len(times) == 0:
        raise _refuse("it has no points")
    for name, values in zip(JointPath._fields[1:], path[1:], strict=True):
        if values is not None and np.shape(values) != (len(times), joints):
            raise _refuse(f"{name} have shape {np.shape(values)} instead of {(len(times), joints)}")
    for name, values in zip(JointPath._fields, path, strict=True):
        if values is not None and not np.isfinite(values).all():
            raise _refuse(f"its {name} are not all finite")
    if times[0] < 0 or np.any(np.diff(times) <= 0):
        raise _refuse("its times do not increase")


def _refuse(what: str) -> DgsError:
    return DgsError(ErrorCode.TRAJECTORY_REJECTED, f"the trajectory cannot be used: {what}")

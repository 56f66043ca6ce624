"""Messages of the simulator <-> plain data: ground truth, FollowJointTrajectory goals, feedback and results."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.msg import SimState
from geometry_msgs.msg import Wrench, WrenchStamped
from numpy.typing import NDArray
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectoryPoint

from dgs_description.errors import DgsError, JointNameError
from dgs_description.frames import BASE_LINK, TOOL0, Array
from dgs_description.joints import ARM_JOINTS
from dgs_ros.pose_msgs import matrix_to_pose, to_vector3
from dgs_ros.trajectory_msgs import seconds, to_duration, to_time, trajectory_to_path
from dgs_sim_bridge.world.arm_controller import ArmGoal, OnProgress, Outcome
from dgs_sim_bridge.world.trajectory import (
    ArmState,
    FollowCode,
    SetPoint,
    Tolerances,
    TrajectoryRefused,
    chosen,
    override,
)
from dgs_sim_bridge.world.world import ObjectState


def to_sim_state(states: Sequence[ObjectState], now: float) -> SimState:
    """Ground truth of all objects."""
    return SimState(
        header=Header(frame_id=BASE_LINK, stamp=to_time(now)),
        names=[state.name for state in states],
        poses=[matrix_to_pose(state.pose) for state in states],
        places=[state.place for state in states],
    )


def to_wrench(wrench: Array, now: float) -> WrenchStamped:
    """(6,) force [N] and torque [Nm] in the frame "tool0"."""
    return WrenchStamped(
        header=Header(frame_id=TOOL0, stamp=to_time(now)),
        wrench=Wrench(force=to_vector3(wrench[:3]), torque=to_vector3(wrench[3:])),
    )


def goal_from_message(
    message: FollowJointTrajectory.Goal,
    now: float,
    on_end: Callable[[Outcome], None] = lambda outcome: None,
    on_progress: OnProgress = lambda wanted, measured, passed: None,
    warn: Callable[[str], object] = lambda sentence: None,
) -> ArmGoal:
    """The goal that a message asks for.

    With tolerances that mean nothing the default ones hold, as on the real controller, and `warn` is called.

    Raises:
        TrajectoryRefused: what the real controller refuses too: wrong joints, no points, bad shapes or times, numbers
            that are not finite, torques, an end in motion, or one that lies before `now` [s, simulated].
    """
    if message.multi_dof_trajectory.points:
        several = "the arm has no joints with several degrees of freedom"
        raise TrajectoryRefused(FollowCode.INVALID_GOAL, several)
    try:
        path = trajectory_to_path(message.trajectory, ARM_JOINTS)
    except JointNameError as error:
        raise TrajectoryRefused(FollowCode.INVALID_JOINTS, error.message) from error
    except DgsError as error:
        raise TrajectoryRefused(FollowCode.INVALID_GOAL, error.message) from error
    if any(point.effort for point in message.trajectory.points):
        force = "the arm is driven by positions, the points must hold no torques"
        raise TrajectoryRefused(FollowCode.INVALID_GOAL, force)
    if path.velocities is not None and np.abs(path.velocities[-1]).max() > np.finfo(np.float32).eps:
        moving = "the trajectory ends in motion; the velocities of its last point must be 0"
        raise TrajectoryRefused(FollowCode.INVALID_GOAL, moving)
    start: float | None = seconds(message.trajectory.header.stamp) or None
    if start is not None and start + path.times[-1] < now:
        late = f"the trajectory ended at {start + path.times[-1]:.3f} s, it is {now:.3f} s now"
        raise TrajectoryRefused(FollowCode.OLD_HEADER_TIMESTAMP, late)
    try:
        tolerances = _tolerances(message)
    except TrajectoryRefused as wrong:
        warn(f"the default tolerances hold: {wrong.message}")
        tolerances = Tolerances()
    return ArmGoal(path, on_end, tolerances, start, on_progress)


def _tolerances(message: FollowJointTrajectory.Goal) -> Tolerances:
    defaults, on_the_way, at_the_end = Tolerances(), message.path_tolerance, message.goal_tolerance
    return Tolerances(
        path=override(defaults.path, [(t.name, t.position) for t in on_the_way]),
        path_velocity=override(defaults.path_velocity, [(t.name, t.velocity) for t in on_the_way]),
        goal=override(defaults.goal, [(t.name, t.position) for t in at_the_end]),
        goal_velocity=override(defaults.goal_velocity, [(t.name, t.velocity) for t in at_the_end]),
        goal_time=chosen(defaults.goal_time, seconds(message.goal_time_tolerance)),
    )


def to_result(outcome: Outcome) -> FollowJointTrajectory.Result:
    """The action's result."""
    return FollowJointTrajectory.Result(error_code=int(outcome.code), error_string=outcome.message)


def to_feedback(
    wanted: SetPoint, measured: ArmState, passed: float, now: float
) -> FollowJointTrajectory.Feedback:
    """The action's feedback `passed` seconds after the start; `now` is its stamp."""
    error = wanted.positions - measured.positions
    return FollowJointTrajectory.Feedback(
        header=Header(stamp=to_time(now)),
        joint_names=list(ARM_JOINTS),
        desired=_point(wanted.positions, wanted.velocities, wanted.time),
        actual=_point(measured.positions, measured.velocities, passed),
        error=_point(error, wanted.velocities - measured.velocities, wanted.time - passed),
    )


def _point(
    positions: NDArray[np.float64], velocities: NDArray[np.float64], time: float
) -> JointTrajectoryPoint:
    return JointTrajectoryPoint(
        positions=positions.tolist(), velocities=velocities.tolist(), time_from_start=to_duration(time)
    )

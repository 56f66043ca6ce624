"""dgs_interfaces/ExecuteGrasp <-> the pick planner's types, and arm trajectories as FollowJointTrajectory goals."""

from __future__ import annotations

from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import GraspRejection
from ur_msgs.srv import SetPayload

from dgs_arm_executor.homing import HomeReport
from dgs_arm_executor.payload import Payload
from dgs_arm_executor.pick_execution import PickReport
from dgs_arm_executor.pick_types import Candidate, candidates_of
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_description.joints import ARM_JOINTS
from dgs_ros.grasp_msgs import grasps_from_msgs, stage_times_to_msgs
from dgs_ros.trajectory_msgs import JointPath, path_to_trajectory, to_duration


def candidates_from_goal(goal: ExecuteGrasp.Goal) -> list[Candidate]:
    """Candidates of a goal. Raises DgsError FRAME_UNKNOWN, NO_CANDIDATES, GRASP_INVALID."""
    if goal.header.frame_id != BASE_LINK:
        raise DgsError(
            ErrorCode.FRAME_UNKNOWN,
            f"grasps are needed in {BASE_LINK!r}, these are in {goal.header.frame_id!r}",
        )
    if not goal.grasps:
        raise DgsError(ErrorCode.NO_CANDIDATES, "the goal holds no grasps")
    try:
        arrays = grasps_from_msgs(goal.grasps)
    except DgsError as error:
        raise DgsError(ErrorCode.GRASP_INVALID, error.message) from error
    return list(
        candidates_of(
            arrays.position,
            arrays.rotation,
            arrays.pre_grasp_joints,
            arrays.grasp_joints,
            arrays.reference_point,
            arrays.score,
        )
    )


def report_to_result(report: PickReport) -> ExecuteGrasp.Result:
    """The action's result."""
    return ExecuteGrasp.Result(
        error_code=int(report.code),
        message=report.message,
        executed_index=report.executed_index,
        object_held=report.object_held,
        object_released=report.object_released,
        rejections=[
            GraspRejection(index=r.index, code=int(r.code), reason=r.reason) for r in report.rejections
        ],
        stage_times=stage_times_to_msgs(report.stage_times),
    )


def home_report_to_result(report: HomeReport) -> GoHome.Result:
    """The result of /go_home."""
    return GoHome.Result(
        error_code=int(report.code), message=report.message, object_released=report.object_released
    )


def payload_to_request(payload: Payload) -> SetPayload.Request:
    """What the UR driver's service takes."""
    request = SetPayload.Request(mass=float(payload.mass))
    centre = request.center_of_gravity
    centre.x, centre.y, centre.z = payload.centre
    return request


def trajectory_to_goal(trajectory: Trajectory, goal_time_tolerance: float) -> FollowJointTrajectory.Goal:
    """Goal for the arm's controller that starts at once and may end late by `goal_time_tolerance` [s]."""
    path = JointPath(trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations)
    goal = FollowJointTrajectory.Goal(trajectory=path_to_trajectory(ARM_JOINTS, path))
    goal.goal_time_tolerance = to_duration(goal_time_tolerance)
    return goal

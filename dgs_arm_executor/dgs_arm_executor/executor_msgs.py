"""dgs_interfaces/ExecuteGrasp <-> the executor's own types."""

from __future__ import annotations

from collections.abc import Sequence

from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.msg import GraspRejection, PickPlan

from dgs_arm_executor.execution import Report
from dgs_arm_executor.pick_plan import PickAnswer, Rejection
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_description.grasp import GraspSet
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_ros.grasp_msgs import grasps_from_msgs, stage_times_to_msgs
from dgs_ros.trajectory_msgs import path_to_trajectory

_EVERY = 5
"""So many samples of a motion make one point of the picture of it, which is ten a second."""


def grasps_from_goal(goal: ExecuteGrasp.Goal) -> GraspSet:
    """Grasps of a goal. Raises DgsError FRAME_UNKNOWN, NO_CANDIDATES, GRASP_INVALID."""
    if goal.header.frame_id != BASE_LINK:
        where = f"grasps are needed in {BASE_LINK!r}, these are in {goal.header.frame_id!r}"
        raise DgsError(ErrorCode.FRAME_UNKNOWN, where)
    if not goal.grasps:
        raise DgsError(ErrorCode.NO_CANDIDATES, "the goal holds no grasps")
    try:
        return grasps_from_msgs(goal.grasps)
    except DgsError as error:
        raise DgsError(ErrorCode.GRASP_INVALID, error.message) from error


def report_to_result(report: Report) -> ExecuteGrasp.Result:
    """The action's result."""
    return ExecuteGrasp.Result(
        error_code=int(report.code),
        message=report.message,
        executed_index=report.executed_index,
        object_held=report.object_held,
        object_released=report.object_released,
        rejections=_rejections(report.rejections),
        stage_times=stage_times_to_msgs(report.stage_times),
    )


def answer_to_plan(goal: ExecuteGrasp.Goal, answer: PickAnswer) -> PickPlan:
    """What was planned for a goal, for whoever watches; of the motions only the way, ten points a second."""
    trajectories = answer.plan.trajectories if answer.plan is not None else {}
    return PickPlan(
        header=goal.header,
        grasps=goal.grasps,
        chosen=answer.plan.index if answer.plan is not None else -1,
        rejections=_rejections(answer.rejections),
        stages=list(trajectories),
        motions=[path_to_trajectory(ARM_JOINTS, _thinned(each)) for each in trajectories.values()],
    )


def _thinned(trajectory: Trajectory) -> JointPath:
    last = len(trajectory.times) - 1
    kept = [*range(0, last, _EVERY), last]
    return JointPath(trajectory.times[kept], trajectory.positions[kept])


def _rejections(rejections: Sequence[Rejection]) -> list[GraspRejection]:
    return [GraspRejection(index=r.index, code=int(r.code), reason=r.reason) for r in rejections]

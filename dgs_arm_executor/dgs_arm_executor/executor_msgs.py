"""dgs_interfaces/ExecuteGrasp <-> the executor's own types."""

from __future__ import annotations

from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.msg import GraspRejection

from dgs_arm_executor.execution import Report
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_description.grasp import GraspSet
from dgs_ros.grasp_msgs import grasps_from_msgs, stage_times_to_msgs


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
        rejections=[
            GraspRejection(index=r.index, code=int(r.code), reason=r.reason) for r in report.rejections
        ],
        stage_times=stage_times_to_msgs(report.stage_times),
    )

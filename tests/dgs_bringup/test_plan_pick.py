"""plan_pick: what it prints, and its exit codes for bad arguments and missing nodes."""

from __future__ import annotations

import os
import subprocess

import pytest
from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.msg import Grasp, GraspRejection
from dgs_interfaces.srv import PredictGrasps

from dgs_bringup import plan_pick
from dgs_bringup.plan_pick import describe_plan, describe_prediction
from dgs_description.errors import ErrorCode
from tests.support.environment import ros_environment


def test_the_best_grasps_are_listed_and_an_error_is_told() -> None:
    grasps = [Grasp(score=0.9 - 0.1 * k, proposed=k == 1) for k in range(8)]
    grasps[0].tcp_pose.position.z = -0.125
    answer = PredictGrasps.Response(grasps=grasps, points_used=20000, model_id="dgs_net")
    answer.header.frame_id = "base_link"
    lines = describe_prediction(answer)
    assert lines[0] == "8 grasps in base_link from 20000 points (dgs_net)"
    assert lines[1] == "  0: score 0.90, TCP at (0.000, 0.000, -0.125) m" and len(lines) == 6
    assert lines[2].endswith("m, a level pinch")
    nothing = PredictGrasps.Response(error_code=int(ErrorCode.NO_GRASP), message="nothing to grasp.")
    assert describe_prediction(nothing)[-1] == f"/predict_grasps: {int(ErrorCode.NO_GRASP)} nothing to grasp."


def test_refusals_are_counted_by_code() -> None:
    codes = (ErrorCode.OUT_OF_REACH, ErrorCode.COLLISION_APPROACH, ErrorCode.OUT_OF_REACH)
    result = ExecuteGrasp.Result(
        error_code=0,
        message="grasp 3 can be executed",
        rejections=[GraspRejection(index=k, code=int(code)) for k, code in enumerate(codes)],
    )
    assert describe_plan(result) == [
        "  refused: 2 OUT_OF_REACH",
        "  refused: 1 COLLISION_APPROACH",
        "/execute_grasp: 0 grasp 3 can be executed",
    ]


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(SystemExit) as ended:
        plan_pick.main(["--max-grasps", "0"])
    assert ended.value.code == 2


def test_without_nodes_it_says_what_to_start(ros_domain_id: int) -> None:
    environment = {**ros_environment(), "ROS_DOMAIN_ID": str(ros_domain_id)}
    command = ["ros2", "run", "dgs_bringup", "plan_pick", "--predict-only"]
    done = subprocess.run(
        command, env={**os.environ, **environment}, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 3
    assert "start grasp_planner_node" in done.stderr and not done.stdout

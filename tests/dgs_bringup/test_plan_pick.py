"""plan_pick: what it prints, and its exit codes for bad arguments and missing nodes."""

from __future__ import annotations

import pytest
import typer
from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.msg import Grasp, GraspRejection
from dgs_interfaces.srv import PredictGrasps
from typer.testing import CliRunner, Result

from dgs_bringup import plan_pick
from dgs_bringup.plan_pick import describe_plan, describe_prediction
from dgs_bringup.ros_session import RosSession
from dgs_description.errors import ErrorCode
from tests.support.ros_client import RosClient


def test_the_best_grasps_are_listed_and_an_error_is_told() -> None:
    grasps = [Grasp(score=0.9 - 0.1 * k, source=("dgs_net", "level_pinch")[k % 2]) for k in range(8)]
    grasps[0].tcp_pose.position.z = -0.125
    answer = PredictGrasps.Response(grasps=grasps, points_used=20000, model_id="dgs_net")
    answer.header.frame_id = "base_link"
    lines = describe_prediction(answer)
    assert lines[0] == "8 grasps in base_link from 20000 points (dgs_net)"
    assert lines[1] == "  0: score 0.90, TCP at (0.000, 0.000, -0.125) m, by dgs_net" and len(lines) == 6
    assert lines[2].endswith("m, by level_pinch")
    answer.grasps = grasps[:1]
    assert describe_prediction(answer)[0].startswith("1 grasp in base_link")
    nothing = PredictGrasps.Response(error_code=int(ErrorCode.NO_GRASP), message="nothing to grasp.")
    assert describe_prediction(nothing)[-1] == f"/predict_grasps: {int(ErrorCode.NO_GRASP)} nothing to grasp."


def test_refusals_are_counted_by_code_and_have_reasons() -> None:
    codes = (*[ErrorCode.COLLISION_APPROACH] * 3, *[ErrorCode.OUT_OF_REACH] * 4)
    result = ExecuteGrasp.Result(
        error_code=0,
        message="grasp 3 can be executed",
        rejections=[
            GraspRejection(index=k, code=int(code), reason=f"too far {k}") for k, code in enumerate(codes)
        ],
    )
    assert describe_plan(result) == [
        "  refused: 4 OUT_OF_REACH",
        "  refused: 3 COLLISION_APPROACH",
        *(f"    {k}: too far {k}" for k in range(5)),
        "/execute_grasp: 0 grasp 3 can be executed",
    ]


def run(*arguments: str) -> Result:
    app = typer.Typer()
    app.command()(plan_pick.plan_pick)
    return CliRunner().invoke(app, arguments)


def test_bad_arguments_are_refused() -> None:
    assert run("--max-grasps", "0").exit_code == 2
    assert run("--max-grasps", "257").exit_code == 2, "the planner gives no more"
    assert run("--seed", "-1").exit_code == 2
    assert run("--seed", str(2**64)).exit_code == 2


def test_a_planner_without_a_cloud_is_silent(
    ros_domain_id: int, ros_client: RosClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    monkeypatch.setattr(RosSession, "appear", 3.0)

    def answer(_: PredictGrasps.Request, response: PredictGrasps.Response) -> PredictGrasps.Response:
        response.error_code, response.message = int(ErrorCode.NO_CLOUD_YET), "no cloud: start camera_node"
        return response

    ros_client.node.create_service(PredictGrasps, "/predict_grasps", answer)
    done = run("--predict-only")
    assert done.exit_code == 3 and "start camera_node" in done.stderr


def test_without_nodes_it_says_what_to_start(ros_domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    monkeypatch.setattr(RosSession, "appear", 0.2)
    done = run("--predict-only")
    assert done.exit_code == 3
    assert "start grasp_planner_node" in done.stderr and not done.stdout

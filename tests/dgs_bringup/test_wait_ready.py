"""What wait_ready prints of nodes that are there."""

from __future__ import annotations

import pytest
import typer
from dgs_interfaces.srv import PredictGrasps
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import PointCloud2

from dgs_bringup.wait_ready import wait_ready
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


@pytest.mark.parametrize(
    ("level", "lines"),
    [(DiagnosticStatus.ERROR, ["ready, but camera_node: depth: no camera"]), (DiagnosticStatus.OK, [])],
)
def test_what_nodes_complain_of_is_printed(
    ros_domain_id: int,
    ros_client: RosClient,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    level: bytes,
    lines: list[str],
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    node = ros_client.node
    node.create_publisher(PointCloud2, "/dgs/cloud", 1)
    node.create_service(PredictGrasps, "/predict_grasps", lambda _, response: response)
    board = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    camera = DiagnosticStatus(
        level=level, name="camera_node: depth", hardware_id="camera_node", message="no camera"
    )
    planner = DiagnosticStatus(name="grasp_planner_node", hardware_id="grasp_planner_node", message="ready")
    node.create_timer(0.1, lambda: board.publish(DiagnosticArray(status=[camera, planner])))
    wait_ready("replay", GUARD)
    assert capsys.readouterr().out.splitlines() == lines


@pytest.mark.parametrize("served", [False, True])
def test_another_suite_in_the_domain_is_named_before_anything_starts(
    ros_domain_id: int,
    ros_client: RosClient,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    served: bool,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    if not served:
        wait_ready("robot", before=True)
        return
    ros_client.node.create_service(PredictGrasps, "/predict_grasps", lambda _, response: response)
    with pytest.raises(typer.Exit) as ended:
        wait_ready("robot", before=True)
    assert ended.value.exit_code == 1
    assert "there already: /predict_grasps: another suite runs" in capsys.readouterr().err

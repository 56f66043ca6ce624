"""grasp_planner_node as a process: every error code, good calls in between, Ctrl-C in the middle of work."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from dgs_interfaces.msg import GraspArray, TargetRegion
from dgs_interfaces.srv import PredictGrasps
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, PointStamped, Pose, Vector3
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_description.frames import apply, inverse
from dgs_grasp_planner.network import PRESETS, DGSNet, save_network
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.grasp_msgs import grasps_from_msgs
from dgs_ros.pose_msgs import matrix_to_transform
from tests.dgs_grasp_planner.models import save_eager_model
from tests.dgs_grasp_planner.scenes import table_scene
from tests.support.environment import GUARD, reserved_domain_id
from tests.support.processes import NodeProcess, suite_node
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

SERVICE = "/predict_grasps"
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def scene_in_base(seed: int = 1, objects: int = 5) -> np.ndarray:
    """Points of a made-up table in base_link."""
    return apply(CELL.T_base_table, table_scene(seed, objects).astype(np.float64))


@dataclass
class Cell:
    """A running node and a client in its domain."""

    node: NodeProcess
    client: RosClient

    def ask(self, **fields: Any) -> PredictGrasps.Response:
        """Call the service."""
        return self.client.call(PredictGrasps, SERVICE, PredictGrasps.Request(**fields))

    def ask_about(
        self, points: np.ndarray, frame: str = "base_link", **fields: Any
    ) -> PredictGrasps.Response:
        """Call the service with a cloud."""
        return self.ask(cloud=numpy_to_cloud(points, frame), **fields)

    def code(self, **fields: Any) -> ErrorCode:
        """Error code of a call, after looking at its sentence."""
        response = self.ask(**fields)
        assert len(response.message) > 5
        assert response.error_code == 0 or len(response.grasps) == 0
        return ErrorCode(response.error_code)


def start(folder: Path, domain_id: int, **parameters: Any) -> NodeProcess:
    """A node that takes its models from `folder`."""
    parameters = {"models_dir": str(folder), "model": "tiny", "torch_threads": 1, **parameters}
    return suite_node("grasp_planner_node", domain_id, folder, parameters)


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """One node for all tests of good weights."""
    folder = tmp_path_factory.mktemp("models")
    save_eager_model(folder)
    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id) as client,
        start(folder, domain_id, max_cloud_age=2.0) as node,
    ):
        node.wait_for_log(r"\bready\b")
        yield Cell(node, client)


def test_no_cloud_yet(cell: Cell) -> None:
    assert cell.code() == ErrorCode.NO_CLOUD_YET


def test_a_good_cloud_is_answered_in_base_link(cell: Cell) -> None:
    points = scene_in_base()
    response = cell.ask_about(points, seed=5)
    assert (response.error_code, response.header.frame_id) == (0, "base_link")
    assert (response.points_in, response.model_id, len(response.model_sha256)) == (len(points), "tiny", 64)
    assert 0 < response.points_used <= 20_000
    assert response.stage_times[-1].stage == "total"
    grasps = grasps_from_msgs(response.grasps)
    assert (np.diff(grasps.score) <= 0).all()
    nearest = np.linalg.norm(grasps.reference_point[:, None] - points[None], axis=2).min(1)
    assert (nearest < 0.006).all()
    assert (grasps.position[:, 2] > CELL.table_height).all()
    assert cell.node.log().count("the cell's pose of it is taken") == 1, "nobody told where the camera stands"
    again = grasps_from_msgs(cell.ask_about(points, seed=5).grasps)
    for field in fields(grasps):
        np.testing.assert_array_equal(getattr(grasps, field.name), getattr(again, field.name))


def test_four_bad_clouds_have_four_codes_and_the_next_good_call_is_answered(cell: Cell) -> None:
    good = scene_in_base()
    with_nan = good.copy()
    with_nan[::7] = np.nan
    bad = {
        ErrorCode.CLOUD_NOT_FINITE: numpy_to_cloud(with_nan, "base_link"),
        ErrorCode.CLOUD_EMPTY: numpy_to_cloud(good[:0], "base_link"),
        ErrorCode.CLOUD_FRAME_UNKNOWN: numpy_to_cloud(good, "moon"),
        ErrorCode.NO_OBJECTS: numpy_to_cloud(scene_in_base(objects=0), "base_link"),
    }
    for code, cloud in bad.items():
        assert cell.code(cloud=cloud) == code
        assert cell.ask_about(good).error_code == 0
    assert cell.node.exit_code is None


def test_a_cloud_that_cannot_be_read(cell: Cell) -> None:
    cloud = numpy_to_cloud(scene_in_base(), "base_link")
    cloud.fields = cloud.fields[:2]
    assert cell.code(cloud=cloud) == ErrorCode.CLOUD_FORMAT
    cut = numpy_to_cloud(scene_in_base(), "base_link")
    cut.data = cut.data[:100]
    assert cell.code(cloud=cut) == ErrorCode.CLOUD_FORMAT


def test_wishes(cell: Cell) -> None:
    points = scene_in_base()
    cloud = numpy_to_cloud(points, "base_link")
    assert cell.code(cloud=cloud, min_score=2.0) == ErrorCode.REQUEST_INVALID
    assert cell.code(cloud=cloud, max_grasps=10_000) == ErrorCode.REQUEST_INVALID
    assert len(cell.ask(cloud=cloud, max_grasps=1).grasps) == 1
    region = TargetRegion(
        header=Header(frame_id="base_link"), center=Pose(), size=Vector3(x=9.0, y=9.0, z=9.0)
    )
    assert cell.code(cloud=cloud, target_region=region) == ErrorCode.SUCCESS
    region.size = Vector3(x=0.01, y=0.01, z=0.01)
    assert cell.code(cloud=cloud, target_region=region) == ErrorCode.NO_GRASP
    region.header.frame_id = "moon"
    assert cell.code(cloud=cloud, target_region=region) == ErrorCode.REGION_INVALID


def test_a_cloud_in_the_cameras_frame(cell: Cell) -> None:
    """First by the node's parameters, then by /tf_static."""
    points = scene_in_base()
    T_base_optical = CELL.T_base_camera_optical
    frame = "camera_depth_optical_frame"
    direct = cell.ask_about(points)
    by_parameter = cell.ask_about(apply(inverse(T_base_optical), points), frame)
    assert by_parameter.error_code == 0
    assert abs(len(by_parameter.grasps) - len(direct.grasps)) <= 3
    moved = CELL.T_base_table @ inverse(CELL.T_base_table)
    publisher = cell.client.node.create_publisher(TFMessage, "/tf_static", LATCHED)
    publisher.publish(TFMessage(transforms=[matrix_to_transform(moved, "base_link", "world_copy")]))
    cell.node.wait_ready(lambda: cell.ask_about(points, "world_copy").error_code == 0)


def test_the_newest_cloud_of_the_topic_is_used_until_it_is_stale(cell: Cell) -> None:
    publisher = cell.client.node.create_publisher(PointCloud2, "/dgs/cloud", qos_profile_sensor_data)
    cloud = numpy_to_cloud(scene_in_base(), "base_link")
    cloud.header.stamp.sec = 1234

    def served() -> bool:
        publisher.publish(cloud)
        answer = cell.ask()
        return answer.error_code == 0 and answer.header.stamp.sec == 1234

    cell.node.wait_ready(served)
    cell.node.wait_ready(lambda: cell.code() == ErrorCode.CLOUD_STALE)


def test_a_point_says_what_to_grasp_and_a_box_what_not(cell: Cell) -> None:
    everything = cell.ask_about(scene_in_base())
    aim = everything.grasps[0].reference_point
    target = PointStamped(header=Header(frame_id="base_link"), point=aim)
    one = cell.ask_about(scene_in_base(), target_points=[target])
    assert one.error_code == 0
    assert all(_between(grasp.reference_point, aim) < 0.14 for grasp in one.grasps)
    size = Vector3(x=0.16, y=0.16, z=0.4)
    box = TargetRegion(header=target.header, center=Pose(position=aim), size=size)
    others = cell.ask_about(scene_in_base(), keep_out=[box])
    assert others.error_code in (0, ErrorCode.NO_GRASP)
    assert all(_between(grasp.reference_point, aim) > 0.08 for grasp in others.grasps)
    nowhere = PointStamped(header=target.header, point=Point(x=0.3, y=0.39, z=-0.2))
    assert cell.ask_about(scene_in_base(), target_points=[nowhere]).error_code == ErrorCode.NO_OBJECTS


def _between(a: Point, b: Point) -> float:
    return float(np.hypot(a.x - b.x, a.y - b.y))


def test_markers_are_latched(cell: Cell) -> None:
    response = cell.ask_about(scene_in_base())
    (markers,) = cell.client.collect(MarkerArray, "/dgs/grasp_markers", 1, LATCHED)
    tips = next(marker for marker in markers.markers if marker.ns == "fingertips")
    assert len(tips.points) == 5 * len(response.grasps)
    assert tips.header.frame_id == "base_link"


def test_the_newest_grasps_are_latched(cell: Cell) -> None:
    response = cell.ask_about(scene_in_base())
    (newest,) = cell.client.collect(GraspArray, "/dgs/grasps", 1, LATCHED)
    assert newest.grasps == response.grasps
    assert newest.header == response.header


def test_requests_at_the_same_time_are_all_answered(cell: Cell) -> None:
    client = cell.client.node.create_client(PredictGrasps, SERVICE)
    assert client.wait_for_service(5.0)
    request = PredictGrasps.Request(cloud=numpy_to_cloud(scene_in_base(), "base_link"))
    # No more than the depth of a service's history: the middleware drops what is beyond it.
    futures = [client.call_async(request) for _ in range(8)]
    codes = [ErrorCode(cell.client.wait(future).error_code) for future in futures]
    assert set(codes) <= {ErrorCode.SUCCESS, ErrorCode.PLANNER_BUSY}
    assert codes.count(ErrorCode.SUCCESS) >= 4
    assert cell.ask_about(scene_in_base()).error_code == 0


def test_weights_altered_missing_and_right_again(
    tmp_path: Path, ros_domain_id: int, ros_client: RosClient
) -> None:
    save_eager_model(tmp_path)
    path, spare = tmp_path / "tiny.pt", tmp_path / "spare.pt"
    shutil.copy(path, spare)
    data = bytearray(path.read_bytes())
    data[1000] ^= 255
    path.write_bytes(data)
    with start(tmp_path, ros_domain_id) as node:
        cell = Cell(node, ros_client)
        cloud = numpy_to_cloud(scene_in_base(), "base_link")
        assert cell.code(cloud=cloud) == ErrorCode.WEIGHTS_ALTERED
        path.unlink()
        assert cell.code(cloud=cloud) == ErrorCode.WEIGHTS_MISSING
        spare.rename(path)
        assert cell.code(cloud=cloud) == ErrorCode.SUCCESS
        assert node.interrupt() == 0


def test_a_hand_without_weights_has_a_planner_that_says_so(
    tmp_path: Path, ros_domain_id: int, ros_client: RosClient
) -> None:
    with start(tmp_path, ros_domain_id, model=PlannerParameters.model) as node:
        cloud = numpy_to_cloud(scene_in_base(), "base_link")
        assert Cell(node, ros_client).code(cloud=cloud) == ErrorCode.WEIGHTS_MISSING
        assert node.interrupt() == 0


def test_weights_for_another_hand_are_an_error_as_long_as_they_are_there(
    tmp_path: Path, ros_domain_id: int, ros_client: RosClient
) -> None:
    save_eager_model(tmp_path)
    sidecar = tmp_path / "tiny.json"
    ours = sidecar.read_text()
    sidecar.write_text(json.dumps(json.loads(ours) | {"hand": "other"}))
    with start(tmp_path, ros_domain_id) as node:
        cell = Cell(node, ros_client)
        cloud = numpy_to_cloud(scene_in_base(), "base_link")
        assert cell.code(cloud=cloud) == ErrorCode.WRONG_HAND
        (report,) = ros_client.collect(DiagnosticArray, "/diagnostics")
        assert [status.level for status in report.status] == [DiagnosticStatus.ERROR]
        sidecar.write_text(ours)
        assert cell.code(cloud=cloud) == ErrorCode.SUCCESS


def test_slow_predictions_are_answered_in_time_and_ctrl_c_ends_them(
    tmp_path: Path, ros_domain_id: int, ros_client: RosClient
) -> None:
    torch.manual_seed(0)
    # Deep and fine enough that one forward takes longer than the timeout, also on a fast machine.
    deep = replace(PRESETS["fast"], voxel_size=0.003, encoder_depths=(24, 8, 2, 2, 2))
    save_network(DGSNet(deep), tmp_path, "slow")
    with start(tmp_path, ros_domain_id, model="slow", answer_timeout=0.2, queue_length=1) as node:
        cell = Cell(node, ros_client)
        cloud = numpy_to_cloud(scene_in_base(), "base_link")
        # Either the model is still being loaded, or it is there already and too slow.
        assert cell.code(cloud=cloud) in (ErrorCode.PLANNER_BUSY, ErrorCode.PLANNER_INTERNAL)
        node.wait_for_log("model slow .* loaded")
        client = ros_client.node.create_client(PredictGrasps, SERVICE)
        assert client.wait_for_service(5.0)
        seen: set[ErrorCode] = set()
        end = time.monotonic() + GUARD
        # A burst that meets a forward already under way is refused as busy as a whole.
        while ErrorCode.PLANNER_INTERNAL not in seen and time.monotonic() < end:
            futures = [client.call_async(PredictGrasps.Request(cloud=cloud)) for _ in range(5)]
            seen |= {ErrorCode(ros_client.wait(future).error_code) for future in futures}
        assert seen == {ErrorCode.PLANNER_INTERNAL, ErrorCode.PLANNER_BUSY}
        assert node.interrupt() == 0


NO_GPU = pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"nms_radios": 0.1}, "nms_radios"),
        ({"proposers": []}, "no proposers; choose from dgs_net, level_pinch"),
        ({"model": "nope"}, "nope.pt does not exist"),
        pytest.param({"device": "cuda"}, "torch sees none", marks=NO_GPU),
    ],
)
def test_wrong_parameters_are_a_start_up_failure(
    tmp_path: Path, ros_domain_id: int, parameters: dict[str, Any], complaint: str
) -> None:
    with start(tmp_path, ros_domain_id, **parameters) as node:
        assert node.wait() == 2
        assert complaint in node.log() and "Traceback" not in node.log()

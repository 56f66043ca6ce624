"""The camera node as a process: bags, topics and cameras in, clouds in `base_link` out."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from scipy.spatial import cKDTree
from sensor_msgs.msg import Image, PointCloud2
from tf2_msgs.msg import TFMessage

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import T_CAMERA_LINK_OPTICAL, apply, inverse
from dgs_perception.bags import BagMessage, BagSource
from dgs_perception.camera_node import CameraNode
from dgs_perception.pipeline import CloudPipeline
from dgs_perception.realsense_source import DepthFrame
from dgs_ros.cloud_msgs import cloud_to_numpy
from dgs_ros.image_msgs import numpy_to_image
from dgs_ros.pose_msgs import transform_to_matrix
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.shot import take_shot
from tests.dgs_perception.bags import START_NS, write_cloud_bag, write_depth_bag
from tests.dgs_perception.software_camera import RATE, SoftwareCamera
from tests.integration.camera_processes import Diagnostics, camera_node, table_clouds
from tests.integration.published_cameras import (
    D455,
    OPTICAL,
    PARAMETERS,
    TABLE_STAGE,
    DepthCamera,
    StereoCamera,
)
from tests.support.environment import GUARD, REPO_ROOT
from tests.support.processes import suite_node
from tests.support.refused import refused

pytestmark = pytest.mark.integration

LATCHED = QoSProfile(
    depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE
)
TABLE_BAG = str(REPO_ROOT / "tests/data/table_depth")


def stamp_ns(message: Any) -> int:
    return int(Time.from_msg(message.header.stamp).nanoseconds)


@pytest.mark.parametrize(("storage", "frame"), [("sqlite3", "base_link"), ("mcap", OPTICAL)])
def test_clouds_of_a_bag_come_out_in_base_link(ros_domain_id, ros_client, tmp_path, storage, frame):
    base = table_clouds(4, 2000)
    outside = np.array([[0.3, 0.0, 3.0], [np.nan, 0, 0]], np.float32)
    T_base_frame = np.eye(4) if frame == "base_link" else CELL.T_base_camera_optical
    recorded = [apply(inverse(T_base_frame), np.vstack([cloud, outside])) for cloud in base]
    bag = write_cloud_bag(tmp_path / "bag", recorded, frame, storage)
    diagnostics = Diagnostics(ros_client)
    with camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)) as camera:
        clouds = ros_client.collect(PointCloud2, "/dgs/cloud", 6, qos=qos_profile_sensor_data)
        diagnostics.wait_for_clouds(2)  # a rate takes two
        values = diagnostics.wait_for(0, "Clouds come from /dgs/cloud of the bag")
        (transforms,) = ros_client.collect(TFMessage, "/tf_static", 1, qos=LATCHED)
        assert camera.interrupt() == 0
    for cloud in clouds:
        k = round((stamp_ns(cloud) - START_NS) * 30 / 1e9)
        assert stamp_ns(cloud) == START_NS + round(k * 1e9 / 30)
        assert cloud.header.frame_id == "base_link"
        np.testing.assert_allclose(cloud_to_numpy(cloud), base[k], atol=2e-6)
    assert (values["points_received"], values["points_not_finite"], values["points_outside"]) == (
        "2002",
        "1",
        "1",
    )
    assert values["points_kept"] == "2000" and float(values["rate_hz"]) > 0
    check_transforms(transforms)


def check_transforms(message: TFMessage) -> None:
    first, second = message.transforms
    assert (first.header.frame_id, first.child_frame_id) == ("base_link", "camera_link")
    assert (second.header.frame_id, second.child_frame_id) == ("camera_link", OPTICAL)
    T_link_optical = transform_to_matrix(second.transform)
    np.testing.assert_allclose(T_link_optical, T_CAMERA_LINK_OPTICAL, atol=1e-9)
    T_base_optical = transform_to_matrix(first.transform) @ T_link_optical
    np.testing.assert_allclose(T_base_optical, CELL.T_base_camera_optical, atol=1e-8)


def test_depth_images_of_a_bag_come_out_as_clouds_once(ros_domain_id, ros_client, tmp_path):
    depths = [np.full((48, 85), 900 + 10 * k, np.uint16) for k in range(3)]
    bag = write_depth_bag(tmp_path / "bag", depths, 447.0, "mcap", rate=2.0)
    diagnostics = Diagnostics(ros_client)
    clouds: list[PointCloud2] = []
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", clouds.append, qos_profile_sensor_data)
    parameters = {"bag_path": str(bag), "bag_loop": False, "bag_restamp": True, "silence_timeout": 0.5}
    started = time.time_ns()
    with camera_node(ros_domain_id, tmp_path, source="rosbag", **parameters) as camera:
        values = diagnostics.wait_for(0, "has been replayed", clouds="3")
        assert camera.interrupt() == 0
    assert values["points_received"] == str(48 * 85)
    newest = clouds[-1]
    points = cloud_to_numpy(newest)
    expected = [[(u - 42) / 447 * 0.92, (v - 23.5) / 447 * 0.92, 0.92] for v in range(48) for u in range(85)]
    np.testing.assert_allclose(points, apply(CELL.T_base_camera_optical, np.array(expected)), atol=1e-6)
    assert stamp_ns(newest) > started


def until(
    condition: Callable[[], Any], action: Callable[[], Any], timeout: float = GUARD, period: float = 0.1
) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, f"not within {timeout} s"
        action()
        time.sleep(period)


def test_depth_topics_good_bad_and_silent(ros_domain_id, ros_client, tmp_path):
    """One node sees everything that may come in, and still delivers at the end."""
    diagnostics, source, clouds = Diagnostics(ros_client), DepthCamera(ros_client), []
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", clouds.append, qos_profile_sensor_data)
    table = np.full((480, 848), 1000, np.uint16)
    with camera_node(ros_domain_id, tmp_path, source="depth_topics", silence_timeout=0.6) as camera:
        camera.wait_ready(source.heard)

        def expect(code: int, sentence: str, *arguments: Any, **keywords: Any) -> None:
            sending = threading.Event()
            sender = threading.Thread(
                target=lambda: repeat(sending, lambda: source.send(*arguments, **keywords))
            )
            sender.start()
            try:
                diagnostics.wait_for(code, sentence)
            finally:
                sending.set()
                sender.join()

        diagnostics.wait_for(401, f"No input from {PARAMETERS.depth_topic} for")
        missing = f"No camera info has come yet on {PARAMETERS.camera_info_topic}"
        expect(404, missing, table, info=None)
        expect(
            404,
            "cannot have an image of 0 x 480 pixels",
            table,
            info_change=lambda info: setattr(info, "width", 0),
        )
        expect(
            404,
            "640 x 480 pixels but the depth image 848 x 480",
            table,
            info=replace(D455, width=640, cx=319.5),
        )
        check_good_cloud(source, clouds, table)
        expect(0, "Clouds come from", table)
        frozen = Time(seconds=1234).to_msg()
        expect(401, "No input", table, change=lambda image: setattr(image.header, "stamp", frozen))
        expect(405, "encoding 'rgb8'", table, change=lambda image: setattr(image, "encoding", "rgb8"))
        expect(405, "bytes of data", table, change=lambda image: setattr(image, "height", 481))
        expect(406, "camera_color_optical_frame", table, change=color_frame)
        for nothing in (np.zeros_like(table), np.full(table.shape, np.nan, np.float32)):
            clouds.clear()
            until(lambda: clouds, lambda depth=nothing: source.send(depth))
            assert clouds[-1].width == 0 and clouds[-1].header.frame_id == "base_link"
        check_good_cloud(source, clouds, table)
        assert camera.interrupt() == 0


def repeat(stop: threading.Event, action: Callable[[], Any]) -> None:
    while not stop.wait(0.1):
        action()


def color_frame(image: Image) -> None:
    image.header.frame_id = "camera_color_optical_frame"


def check_good_cloud(source: DepthCamera, clouds: list[PointCloud2], depth: np.ndarray) -> None:
    clouds.clear()
    sent: set[int] = set()
    until(lambda: any(stamp_ns(cloud) in sent for cloud in clouds), lambda: sent.add(source.send(depth)))
    cloud = next(cloud for cloud in clouds if stamp_ns(cloud) in sent)
    v, u = np.mgrid[:480, :848].reshape(2, -1)
    z = depth.ravel() / 1000
    optical = np.column_stack([(u - D455.cx) / D455.fx * z, (v - D455.cy) / D455.fy * z, z])
    base = apply(CELL.T_base_camera_optical, optical)
    lower, upper = CELL.cloud_bounds
    expected = base[((base >= lower) & (base <= upper)).all(axis=1)]
    points = cloud_to_numpy(cloud)
    assert abs(len(points) - len(expected)) < 5  # points on the border fall to either side by rounding
    distance, _ = cKDTree(expected).query(points[::500])
    assert distance.max() < 2e-6


def test_clouds_from_infrared_pairs(ros_domain_id, ros_client, tmp_path):
    diagnostics, source, clouds = Diagnostics(ros_client), StereoCamera(ros_client), []
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", clouds.append, qos_profile_sensor_data)
    with camera_node(ros_domain_id, tmp_path, depth_from="stereo", silence_timeout=0.6) as camera:
        camera.wait_ready(source.heard)
        pair = f"{PARAMETERS.left_topic} with {PARAMETERS.right_topic} of the same stamp"
        diagnostics.wait_for(401, f"No input from {pair} for")
        sending = threading.Event()
        sender = threading.Thread(target=lambda: repeat(sending, lambda: source.send(baseline=1e-5)))
        sender.start()
        try:
            diagnostics.wait_for(404, "no baseline")
        finally:
            sending.set()
            sender.join()
        until(lambda: clouds, source.send)
        points = cloud_to_numpy(clouds[-1])
        assert len(points) > 10_000 and clouds[-1].header.frame_id == "base_link"
        assert abs(float(np.median(points[:, 2])) - CELL.table_height) < 0.006
        apart = []
        for _ in range(10):
            apart.append(source.send(late=1_000_000))
            time.sleep(0.05)
        diagnostics.wait_for(401, "No input")
        assert not {stamp_ns(cloud) for cloud in clouds} & {
            t + late for t in apart for late in (0, 1_000_000)
        }
        assert camera.interrupt() == 0


def test_clouds_from_completed_depth(ros_domain_id, ros_client, tmp_path):
    source, clouds, diagnostics = DepthCamera(ros_client), [], Diagnostics(ros_client)
    left = ros_client.node.create_publisher(Image, PARAMETERS.left_topic, 10)
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", clouds.append, qos_profile_sensor_data)
    rng = np.random.default_rng(0)
    shot = take_shot(TABLE_STAGE, D455, CELL.T_base_camera_optical, D455Noise(), rng, imagers=1)
    millimetres = np.rint(1000 * shot.depth).astype(np.uint16)

    def send(change: Callable[[Any], None] = lambda image: None) -> None:
        stamp = Time(nanoseconds=source.send(millimetres, change=change)).to_msg()
        left.publish(numpy_to_image(shot.left, "camera_infra1_optical_frame", stamp))

    with camera_node(ros_domain_id, tmp_path, depth_from="completed") as camera:
        camera.wait_ready(lambda: source.heard() and left.get_subscription_count() > 0)
        until(lambda: diagnostics.says(406), lambda: send(color_frame))
        assert not clouds
        until(lambda: clouds, send)
        assert camera.interrupt() == 0
    points = cloud_to_numpy(clouds[-1])
    assert len(points) > 10_000
    assert abs(float(np.median(points[:, 2])) - CELL.table_height) < 0.006


def test_a_real_sense_camera_streams_and_a_failure_on_an_image_has_a_code(ros_client, monkeypatch):
    """librealsense's software device in the place of the camera, everything behind it real."""
    camera = SoftwareCamera()
    values = {
        "source": "realsense",
        "realsense_width": 64,
        "realsense_height": 48,
        "realsense_rate": RATE,
    }
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    node = CameraNode(camera.device, context=ros_client.node.context, parameter_overrides=overrides)
    node.prepare()
    executor = SingleThreadedExecutor(context=ros_client.node.context)
    executor.add_node(node)
    try:
        clouds: list[PointCloud2] = []
        ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", clouds.append, qos_profile_sensor_data)
        depth = np.full((48, 64), 1000, np.uint16)
        until(lambda: clouds, lambda: camera.take(depth, time.time() * 1e3))
        assert clouds[0].width > 0 and clouds[0].header.frame_id == "base_link"
        assert abs(stamp_ns(clouds[0]) - time.time_ns()) < 60e9
        monkeypatch.setattr(CloudPipeline, "from_depth", lambda *_: 1 / 0)
        failed = {"code": int(ErrorCode.CAMERA_INTERNAL)}
        until(
            lambda: failed.items() <= node._health.report().values.items(),
            lambda: camera.take(depth, time.time() * 1e3),
        )
    finally:
        node.stopping.set()
        node.close()
        executor.shutdown()
        node.destroy_node()


def test_a_camera_may_take_long_for_its_first_image_and_is_silent_soon_after_it(ros_client):
    overrides = [Parameter("source", value="realsense"), Parameter("silence_timeout", value=0.1)]
    node = CameraNode(context=ros_client.node.context, parameter_overrides=overrides)
    image = np.zeros((2, 3), np.uint16)
    frame = DepthFrame(image, 0.001, PinholeCamera.centred(3, 2, 5.0), time.time_ns())
    asked: list[DepthFrame | None] = []

    class SlowCamera:
        def next_frame(self, timeout: float) -> DepthFrame | None:
            time.sleep(timeout)
            asked.append(frame if len(asked) == 5 else None)
            return asked[-1]

    try:
        node._stream(SlowCamera())
    finally:
        node.destroy_node()
    assert frame in asked and len(asked) < 9


def test_a_camera_whose_images_take_long_here_is_not_silent(ros_client, monkeypatch):
    overrides = [Parameter("source", value="realsense"), Parameter("silence_timeout", value=0.1)]
    node = CameraNode(context=ros_client.node.context, parameter_overrides=overrides)
    frame = DepthFrame(np.zeros((2, 3), np.uint16), 0.001, PinholeCamera.centred(3, 2, 5.0), time.time_ns())
    frames = iter([frame] * 3)
    worked: list[int] = []

    def work(stamp_ns: int, crop: Any) -> None:
        time.sleep(0.15)
        worked.append(stamp_ns)

    monkeypatch.setattr(node, "_process", work)
    try:
        node._stream(SimpleNamespace(next_frame=lambda timeout: next(frames, None)))
    finally:
        node.destroy_node()
    assert len(worked) == 3


def test_a_node_that_is_active_again_has_forgotten_what_it_saw(ros_client):
    overrides = [Parameter("frames", value=3)]
    node = CameraNode(context=ros_client.node.context, parameter_overrides=overrides)
    try:
        node.trigger_configure()
        for z in (0.5, 0.5, 0.5, 0.0):
            node.trigger_activate()
            assert node._pipeline.median(np.full((1, 1), z, np.float32))[0, 0] == z
            node.trigger_deactivate()
    finally:
        node.stopping.set()
        node.close()
        node.destroy_node()


@pytest.mark.parametrize("damaged", [False, True])
def test_a_bag_waits_for_the_node_to_be_active_and_is_replayed_once(
    ros_client, tmp_path, monkeypatch, damaged
):
    def broken(bag: BagSource) -> Iterator[BagMessage]:
        raise DgsError(ErrorCode.BAG_MISSING, "damaged")

    monkeypatch.setattr("dgs_perception.camera_node.RETRY_PERIOD", 0.0)
    if damaged:
        monkeypatch.setattr(BagSource, "messages", broken)
    bag = write_cloud_bag(tmp_path / "bag", table_clouds(3, 100), rate=100.0)
    values = {"source": "rosbag", "bag_path": str(bag), "bag_loop": False, "silence_timeout": 0.1}
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    node = CameraNode(context=ros_client.node.context, parameter_overrides=overrides)
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", print, qos_profile_sensor_data)
    try:
        node.trigger_configure()
        until(node._clouds.get_subscription_count, lambda: None)
        time.sleep(0.3)
        assert node._thread.is_alive()
        node.trigger_activate()
        node._thread.join(10.0)
        assert not node._thread.is_alive()
        report = node._health.report()
        assert (int(report.code), report.values["clouds"]) == ((402, 0) if damaged else (0, 3))
        monkeypatch.setattr("dgs_perception.health.PROBLEM_MEMORY", 0.0)
        time.sleep(0.2)
        later = node._health.report()
        assert int(later.code) == 0 and ("as far as" in later.sentence) == damaged
    finally:
        node.stopping.set()
        node.close()
        node.destroy_node()


def test_without_a_camera_the_node_says_so_and_waits(ros_domain_id, ros_client, tmp_path):
    diagnostics = Diagnostics(ros_client)
    with camera_node(ros_domain_id, tmp_path, source="realsense", realsense_serial="000000000000") as camera:
        diagnostics.wait_for(400, "No RealSense camera with serial number 000000000000 is connected")
        assert camera.interrupt() == 0


def test_the_process_refuses_to_start_with_a_sentence(ros_domain_id, tmp_path):
    parameters = {"source": "rosbag", "bag_path": "/nowhere/bag"}
    with suite_node("camera_node", ros_domain_id, tmp_path, parameters) as node:
        assert node.wait() == 2
    assert re.search(r"cannot start: No bag can be read at /nowhere/bag.* \(code 402\)", node.log())


@pytest.mark.parametrize(
    ("values", "code", "sentence"),
    [
        ({"source": "rosbag"}, ErrorCode.PARAMETER_INVALID, "needs the parameter 'bag_path'"),
        (
            {"source": "rosbag", "bag_path": "/nowhere"},
            ErrorCode.BAG_MISSING,
            "No bag can be read at /nowhere",
        ),
        (
            {"source": "rosbag", "bag_path": TABLE_BAG, "bag_topic": "/a"},
            ErrorCode.BAG_TOPIC,
            "has no topic /a",
        ),
        ({"depth_from": "magic"}, ErrorCode.PARAMETER_INVALID, "no depth source named"),
        ({"depth_from": "stereo", "source": "realsense"}, ErrorCode.PARAMETER_INVALID, "needs source"),
        ({"depth_from": "/nowhere/net.onnx"}, ErrorCode.DEPTH_SOURCE, "no stereo network at /nowhere"),
        (
            {"depth_topic": "/my-camera/depth"},
            ErrorCode.PARAMETER_INVALID,
            "'depth_topic': .*'/my-camera/depth' is invalid: .*alphanumerics",
        ),
        ({"depth_topic": ""}, ErrorCode.PARAMETER_INVALID, "'depth_topic': .*must not be empty"),
        ({"source": "webcam"}, ErrorCode.PARAMETER_INVALID, "one of 'realsense', 'depth_topics', 'rosbag'"),
    ],
)
def test_parameters_that_are_refused(ros_client, values, code, sentence):
    overrides = [Parameter(name, value=value) for name, value in values.items()]
    with refused(code, sentence):
        CameraNode(context=ros_client.node.context, parameter_overrides=overrides).prepare()


def test_thirty_large_clouds_arrive_without_a_gap(ros_domain_id, ros_client, tmp_path):
    """300 000 points, 3.6 MB each, through the shipped Fast DDS profile at 10 Hz."""
    bag = write_cloud_bag(tmp_path / "bag", table_clouds(10, 300_000), rate=10.0)
    received: list[bytes] = []
    # Deep: a test that gets no processor time for a second must not lose what has arrived.
    deep = QoSProfile(depth=40, reliability=ReliabilityPolicy.BEST_EFFORT)
    with camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)) as camera:
        ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", received.append, deep, raw=True)
        camera.wait_ready(lambda: len(received) >= 30)
        assert camera.interrupt() == 0
    seconds_and_nanoseconds = [np.frombuffer(data, np.int32, 2, offset=4) for data in received[:30]]
    frames = [round((int(s) * 10**9 + int(n) - START_NS) / 1e8) for s, n in seconds_and_nanoseconds]
    assert frames == [(frames[0] + k) % 10 for k in range(30)]
    assert all(len(data) > 3_600_000 for data in received)

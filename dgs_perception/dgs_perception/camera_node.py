"""Publishes one clean cloud in `base_link` from a RealSense camera, from image topics, or from a bag."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from tf2_msgs.msg import TFMessage

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_LINK, T_CAMERA_LINK_OPTICAL
from dgs_description.parameters import ManagedParameters, parameter
from dgs_perception.bags import CAMERA_INFO, IMAGE, BagMessage, BagSource
from dgs_perception.depth_source import RAW, DepthSource, check_name
from dgs_perception.frames_median import FramesMedian
from dgs_perception.health import CameraHealth
from dgs_perception.moments import Moments
from dgs_perception.pipeline import CloudPipeline
from dgs_perception.realsense_source import D455_MODE, RealSenseSource
from dgs_perception.workspace import Cropped
from dgs_ros.base_node import LATCHED
from dgs_ros.cloud_msgs import cloud_to_numpy, numpy_to_cloud
from dgs_ros.diagnostics import Level
from dgs_ros.image_msgs import (
    camera_info_to_baseline,
    camera_info_to_pinhole,
    depth_to_metres,
    depth_to_numpy,
    infrared_to_numpy,
)
from dgs_ros.managed_node import ManagedNode
from dgs_ros.pose_msgs import matrix_to_transform
from dgs_ros.run import run

NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears reliable publishers too
REPORT_PERIOD = 0.5
RETRY_PERIOD = 2.0
"""Pause before a camera that could not be opened is tried again [s]."""
FIRST_IMAGE = 5.0
"""So long a camera that was opened may take for its first image, at least [s]; librealsense waits for as long."""

REALSENSE, DEPTH_TOPICS, ROSBAG = SOURCES = ("realsense", "depth_topics", "rosbag")


@dataclass(frozen=True)
class CameraParameters(ManagedParameters):
    """Where depth comes from and what is kept of it; refused with a ValueError when they do not fit together."""

    source: str = parameter(DEPTH_TOPICS, "Where images come from.", choices=SOURCES)
    depth_from: str = parameter(
        RAW,
        "Depth with source depth_topics: raw (the camera's), completed (a network fills in glass), stereo, or the path "
        "of a stereo network (.onnx).",
    )
    publish_optical_frame: bool = parameter(
        True, "Send camera link -> optical frame on /tf_static; switch off where realsense-ros does."
    )
    frames: int = parameter(
        1, "Depth images whose median is taken where nothing moves; 1 = each as it is.", 1, 30
    )
    edge_filter: bool = parameter(True, "Set flying pixels at the edges of things right, or take them out.")
    silence_timeout: float = parameter(
        2.0, "Without input for so long the camera counts as silent [s].", 0.1, 600.0
    )
    depth_topic: str = parameter(
        "/camera/camera/depth/image_rect_raw", "Depth images for source depth_topics."
    )
    camera_info_topic: str = parameter(
        "/camera/camera/depth/camera_info", "Camera info for source depth_topics."
    )
    left_topic: str = parameter(
        "/camera/camera/infra1/image_rect_raw", "Left infrared images, where depth_from needs them."
    )
    right_topic: str = parameter(
        "/camera/camera/infra2/image_rect_raw", "Right infrared images, where depth_from needs them."
    )
    right_info_topic: str = parameter(
        "/camera/camera/infra2/camera_info", "Camera info of the right imager; says the baseline."
    )
    realsense_serial: str = parameter(
        "",
        "Serial number for source realsense, a text though it is digits: '123' in a file, \"'123'\" in a shell; empty: "
        "the first camera found.",
    )
    realsense_width: int = parameter(D455_MODE[0], "Depth image width [px].", 1, 1280)
    realsense_height: int = parameter(D455_MODE[1], "Depth image height [px].", 1, 800)
    realsense_rate: int = parameter(D455_MODE[2], "Depth images per second [Hz].", 1, 90)
    bag_path: str = parameter("", "Folder or file of the bag for source rosbag.")
    bag_topic: str = parameter("", "Cloud or depth topic in the bag; empty: found by type.", optional=True)
    bag_rate: float = parameter(1.0, "Factor on the recorded pace.", 0.01, 100.0)
    bag_loop: bool = parameter(True, "Start again at the end of the bag.")
    bag_restamp: bool = parameter(
        False, "Stamp replayed clouds with the present time instead of the recorded one."
    )

    def __post_init__(self) -> None:
        if self.source == ROSBAG and not self.bag_path:
            raise ValueError("source 'rosbag' needs the parameter 'bag_path'")
        try:
            check_name(self.depth_from)
        except DgsError as error:
            raise ValueError(error.message) from error
        if self.depth_from != RAW and self.source != DEPTH_TOPICS:
            raise ValueError(f"depth_from {self.depth_from!r} needs source {DEPTH_TOPICS!r}")


class CameraNode(ManagedNode[CameraParameters]):
    """Parameters, topics and the thread of the source; the work is done by `CloudPipeline`."""

    def __init__(self, device: Any = None, **node_arguments: Any) -> None:
        """Read the parameters; `device` is an `rs.device` for source realsense instead of the one that is connected.

        Raises:
            DgsError: PARAMETER_INVALID.
        """
        super().__init__("camera_node", CameraParameters, **node_arguments)
        self._device = device
        self._thread: threading.Thread | None = None
        self._bag: BagSource | None = None
        self._infos: dict[str, Any] = {}
        self._last_stamp_ns = -1
        self._pipeline = self._new_pipeline()
        self._clouds = self.create_publisher(PointCloud2, "/dgs/cloud", qos_profile_sensor_data)
        self._transforms = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._publish_transforms()

    def start(self) -> None:
        """Open the source.

        Raises:
            DgsError: DEPTH_SOURCE, BAG_MISSING or BAG_TOPIC. A camera that is not there is no reason to give up: it is
                tried again until it comes.
        """
        starts = {DEPTH_TOPICS: self._start_topics, REALSENSE: self._start_realsense, ROSBAG: self._start_bag}
        name = starts[self.parameters.source]()
        self._health = CameraHealth(name, self.parameters.silence_timeout)
        self.every(REPORT_PERIOD, self._report)
        if self._thread is not None:
            self._thread.start()

    def close(self) -> None:
        """Stop the source's thread and close the bag."""
        if self._thread is not None:
            self._thread.join(timeout=2.0)
        if self._bag is not None and not (self._thread and self._thread.is_alive()):
            self._bag.close()

    def _new_pipeline(self) -> CloudPipeline:
        median = FramesMedian(self.parameters.frames) if self.parameters.frames > 1 else None
        return CloudPipeline(CELL, self.parameters.edge_filter, median)

    def _publish_transforms(self) -> None:
        stamp = self.get_clock().now().to_msg()
        transforms = [matrix_to_transform(CELL.T_base_camera_link, BASE_LINK, CAMERA_LINK, stamp)]
        if self.parameters.publish_optical_frame:
            frames = CAMERA_LINK, CELL.optical_frame
            transforms.append(matrix_to_transform(T_CAMERA_LINK_OPTICAL, *frames, stamp))
        self._transforms.publish(TFMessage(transforms=transforms))

    # image topics

    def _start_topics(self) -> str:
        p, one, other = self.parameters, MutuallyExclusiveCallbackGroup(), MutuallyExclusiveCallbackGroup()
        self._depth_source = DepthSource(p.depth_from)
        infrared = [("left", p.left_topic), ("right", p.right_topic)][: self._depth_source.imagers]
        topics = dict([("depth", p.depth_topic)] * self._depth_source.needs_depth + infrared)
        self._moments = Moments(list(topics))
        infos = [("depth", p.camera_info_topic), ("right", p.right_info_topic)]
        for name, topic in infos if "right" in topics else infos[:1]:
            on_info = partial(self._on_info, name)
            self.create_subscription(CameraInfo, topic, on_info, NEWEST_ONLY, callback_group=one)
        for name, topic in topics.items():
            on_image = partial(self._on_image, name)
            self.create_subscription(Image, topic, on_image, NEWEST_ONLY, callback_group=other)
        return " with ".join(topics.values()) + " of the same stamp" * (len(topics) > 1)

    def _on_info(self, name: str, info: Any) -> None:
        self._infos[name] = info

    def _info(self, name: str) -> Any:
        """The newest camera info of the `depth` images, which is the left imager's, or of the `right` one."""
        if name not in self._infos:
            p = self.parameters
            topic = p.right_info_topic if name == "right" else p.camera_info_topic
            nothing = f"No camera info has come yet on {topic}; images are skipped until it does."
            raise DgsError(ErrorCode.CAMERA_INFO_INVALID, nothing)
        return self._infos[name]

    def _on_image(self, name: str, image: Any) -> None:
        stamp_ns = Time.from_msg(image.header.stamp).nanoseconds
        images = self._moments.add(name, stamp_ns, image)
        if images is None or stamp_ns == self._last_stamp_ns:
            return  # a frozen camera repeats its last image; that is silence
        self._last_stamp_ns = stamp_ns
        raw = self.parameters.depth_from == RAW
        self._process(stamp_ns, partial(self._crop_depth, image) if raw else partial(self._crop_made, images))

    def _crop_made(self, images: dict[str, Any]) -> Cropped:
        """Depth that is made here, in the left imager's place, which is the depth image's."""
        camera = camera_info_to_pinhole(self._info("depth"))
        baseline = camera_info_to_baseline(self._info("right")) if "right" in images else 0.0
        depth = depth_to_metres(images["depth"]) if "depth" in images else None
        left, right = (infrared_to_numpy(images[n]) if n in images else None for n in ("left", "right"))
        made = self._depth_source(depth, left, right, camera, baseline)
        frame_id = images["depth"].header.frame_id if "depth" in images else CELL.optical_frame
        return self._pipeline.from_depth(made, camera, frame_id)

    def _crop_depth(self, image: Any) -> Cropped:
        camera = camera_info_to_pinhole(self._info("depth"))
        return self._pipeline.from_depth(depth_to_numpy(image), camera, image.header.frame_id)

    def _crop_cloud(self, cloud: Any) -> Cropped:
        return self._pipeline.from_cloud(cloud_to_numpy(cloud), cloud.header.frame_id)

    # RealSense camera

    def _start_realsense(self) -> str:
        self._thread = threading.Thread(target=self._run_realsense, name="realsense", daemon=True)
        serial = self.parameters.realsense_serial
        return f"RealSense camera {serial}" if serial else "the RealSense camera"

    def _run_realsense(self) -> None:
        p = self.parameters
        mode = p.realsense_width, p.realsense_height, p.realsense_rate
        while not self.stopping.is_set():
            with (
                self._skipping_bad_input(),
                closing(RealSenseSource(p.realsense_serial, mode, self._device)) as camera,
            ):
                self.get_logger().info(f"streaming from {camera.name}")
                self._stream(camera)
            self.stopping.wait(RETRY_PERIOD)

    def _stream(self, camera: RealSenseSource) -> None:
        """Until the node ends or the camera is silent: it is opened anew then, as if plugged in again."""
        patience = self.parameters.silence_timeout
        end = time.monotonic() + max(patience, FIRST_IMAGE)
        frame_id = CELL.optical_frame
        while not self.stopping.is_set():
            frame = camera.next_frame(timeout=0.1)
            if frame is not None:
                image = frame.depth, frame.camera, frame_id, frame.depth_unit
                self._process(frame.stamp_ns, partial(self._pipeline.from_depth, *image))
                end = time.monotonic() + patience  # what took long here is not the camera's silence
            elif time.monotonic() > end:
                return

    # bag

    def _start_bag(self) -> str:
        p = self.parameters
        self._bag = BagSource(p.bag_path, p.bag_topic)
        self._thread = threading.Thread(target=self._run_bag, args=(self._bag,), name="bag", daemon=True)
        return f"{self._bag.topic} of the bag {p.bag_path}"

    def _run_bag(self, bag: BagSource) -> None:
        self._wait_for_listener()
        while not self.stopping.is_set():
            with self._skipping_bad_input():
                for message in bag.replay(self.stopping, self.parameters.bag_rate, self.parameters.bag_loop):
                    self._on_bag_message(message)
                if not self.stopping.is_set():
                    self._health.idle(f"The bag {bag.path} has been replayed.")
                return
            if not self.parameters.bag_loop:
                self._health.idle(f"The bag {bag.path} has been replayed as far as it can be read.")
                return
            self.stopping.wait(RETRY_PERIOD)

    def _wait_for_listener(self) -> None:
        """Until the node is active and heard: the beginning of the bag would be lost."""
        self._health.idle(f"The bag is replayed as soon as somebody listens to {self._clouds.topic_name}.")
        while not (self.active and self._clouds.get_subscription_count()):
            if self.stopping.wait(0.05):
                return
        self._health.idle("")

    def _on_bag_message(self, message: BagMessage) -> None:
        content = message.content
        if message.type == CAMERA_INFO:
            self._on_info("depth", content)
            return
        stamp = content.header.stamp
        stamp_ns = stamp.sec * 10**9 + stamp.nanosec
        if self.parameters.bag_restamp:
            stamp_ns = self.get_clock().now().nanoseconds
        crop = self._crop_depth if message.type == IMAGE else self._crop_cloud
        self._process(stamp_ns, partial(crop, content))

    # all sources

    def _process(self, stamp_ns: int, crop: Callable[[], Cropped]) -> None:
        if not self.active:
            return
        started = time.monotonic()
        with self._skipping_bad_input():
            points, counts = crop()
            stamp = Time(nanoseconds=stamp_ns).to_msg()
            self._clouds.publish(numpy_to_cloud(points, BASE_LINK, stamp))
            age = (self.get_clock().now().nanoseconds - stamp_ns) * 1e-9
            self._health.cloud(counts, time.monotonic() - started, age)

    @contextmanager
    def _skipping_bad_input(self) -> Iterator[None]:
        """Report what goes wrong in the block and go on with the next input."""
        try:
            yield
        except DgsError as error:
            self._skip(error)
        except Exception as error:
            if not self.context.ok():
                return  # publishers are gone while the node ends
            traceback.print_exc()
            self._skip(DgsError(ErrorCode.CAMERA_INTERNAL, f"The camera node failed on an input: {error!r}."))

    def _skip(self, error: DgsError) -> None:
        if self._health.skipped(error):
            self.get_logger().warning(f"{error.message} (code {int(error.code)})")

    def serve(self) -> None:
        """Silence counts from here: nobody listened before. What was seen before a pause is forgotten."""
        self._pipeline = self._new_pipeline()
        self._health.resumed()

    def _report(self) -> None:
        if not self.active:
            return
        report = self._health.report()
        bad = Level.WARN if report.code == ErrorCode.SUCCESS else Level.ERROR
        self.report(bad if report.degraded else Level.OK, report.sentence, **report.values)


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_perception camera_node`."""
    run(CameraNode, args)

"""Recorded bags for the tests, written with the suite's own writer."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
from rclpy.serialization import serialize_message
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image

from dgs_description.camera import PinholeCamera
from dgs_perception.bags import BagWriter
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info

DEPTH_TOPIC = "/camera/camera/depth/image_rect_raw"
INFO_TOPIC = "/camera/camera/depth/camera_info"
OPTICAL_FRAME = "camera_depth_optical_frame"
START_NS = 1_700_000_000_123_456_789


def stamp_of(stamp_ns: int):
    return Time(nanoseconds=stamp_ns).to_msg()


def depth_image(depth: np.ndarray, stamp_ns: int) -> Image:
    return numpy_to_image(depth, OPTICAL_FRAME, stamp_of(stamp_ns))


def camera_info(width: int, height: int, focal: float, stamp_ns: int) -> CameraInfo:
    camera = PinholeCamera.centred(width, height, focal)
    return pinhole_to_camera_info(camera, OPTICAL_FRAME, stamp_of(stamp_ns))


def write(writer: BagWriter, topic: str, message, stamp_ns: int) -> None:
    """Append a message of sensor_msgs."""
    kind = f"sensor_msgs/msg/{type(message).__name__}"
    writer.write(topic, kind, serialize_message(message), stamp_ns)


def write_cloud(
    writer: BagWriter,
    points: np.ndarray,
    frame_id: str = "base_link",
    stamp_ns: int = START_NS,
    topic: str = "/dgs/cloud",
) -> None:
    """Append a cloud."""
    write(writer, topic, numpy_to_cloud(points, frame_id, stamp_of(stamp_ns)), stamp_ns)


def write_depth_bag(
    path: Path, depths: list[np.ndarray], focal: float, storage: str = "sqlite3", rate: float = 30.0
) -> Path:
    """A bag as `ros2 bag record` makes it of a running camera: each camera info just after its image."""
    with closing(BagWriter(path, storage)) as writer:
        for k, depth in enumerate(depths):
            stamp = START_NS + round(k * 1e9 / rate)
            write(writer, DEPTH_TOPIC, depth_image(depth, stamp), stamp)
            write(writer, INFO_TOPIC, camera_info(depth.shape[1], depth.shape[0], focal, stamp), stamp + 1000)
    return path


def write_cloud_bag(
    path: Path,
    clouds: list[np.ndarray],
    frame_id: str = "base_link",
    storage: str = "sqlite3",
    rate: float = 30.0,
    compress: bool = False,
) -> Path:
    """A bag of clouds on `/dgs/cloud`."""
    with closing(BagWriter(path, storage, compress)) as writer:
        for k, cloud in enumerate(clouds):
            write_cloud(writer, cloud, frame_id, START_NS + round(k * 1e9 / rate))
    return path

"""Recorded bags for the tests, written with the suite's own writer or message by message through rosbags."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

from dgs_perception.bag_writer import BagWriter

TYPES = get_typestore(Stores.ROS2_JAZZY).types
DEPTH_TOPIC = "/camera/camera/depth/image_rect_raw"
INFO_TOPIC = "/camera/camera/depth/camera_info"
START_NS = 1_700_000_000_123_456_789


def header(stamp_ns: int, frame_id: str):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def depth_image(
    depth: np.ndarray, stamp_ns: int, frame_id: str = "camera_depth_optical_frame", encoding: str = "16UC1"
):
    height, width = depth.shape
    return TYPES["sensor_msgs/msg/Image"](
        header=header(stamp_ns, frame_id),
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=width * depth.itemsize,
        data=np.ascontiguousarray(depth).view(np.uint8).ravel(),
    )


def camera_info(
    width: int, height: int, focal: float, stamp_ns: int, frame_id: str = "camera_depth_optical_frame"
):
    cx, cy = (width - 1) / 2, (height - 1) / 2
    return TYPES["sensor_msgs/msg/CameraInfo"](
        header=header(stamp_ns, frame_id),
        height=height,
        width=width,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([focal, 0, cx, 0, focal, cy, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.array([focal, 0, cx, 0, 0, focal, cy, 0, 0, 0, 1, 0]),
        binning_x=0,
        binning_y=0,
        roi=TYPES["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )


def write_depth_bag(
    path: Path, depths: list[np.ndarray], focal: float, storage: str = "sqlite3", rate: float = 30.0
) -> Path:
    """A bag as `ros2 bag record` makes it of a running camera: each camera info just after its image."""
    with BagWriter(path, storage) as writer:
        for k, depth in enumerate(depths):
            stamp = START_NS + round(k * 1e9 / rate)
            writer.write(DEPTH_TOPIC, depth_image(depth, stamp), stamp)
            writer.write(INFO_TOPIC, camera_info(depth.shape[1], depth.shape[0], focal, stamp), stamp + 1000)
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
    with BagWriter(path, storage, compress) as writer:
        for k, cloud in enumerate(clouds):
            writer.write_cloud(cloud, frame_id, START_NS + round(k * 1e9 / rate))
    return path

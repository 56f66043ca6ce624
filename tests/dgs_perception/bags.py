"""Recorded bags for the tests, written with the suite's own writer or message by message through rosbags."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
from rosbags.typesys import Stores, get_typestore

from dgs_perception.bags import BagWriter

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
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


def point_cloud(points: np.ndarray, frame_id: str, stamp_ns: int):
    array = np.ascontiguousarray(points, np.float32).reshape(-1, 3)
    field, float32 = TYPES["sensor_msgs/msg/PointField"], 7
    return TYPES["sensor_msgs/msg/PointCloud2"](
        header=header(stamp_ns, frame_id),
        height=1,
        width=len(array),
        fields=[field(name=name, offset=4 * k, datatype=float32, count=1) for k, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(array),
        data=array.view(np.uint8).ravel(),
        is_dense=True,
    )


def write(writer: BagWriter, topic: str, message, stamp_ns: int) -> None:
    """Append a message made with the types of `rosbags`."""
    kind = message.__msgtype__
    writer.write(topic, kind, bytes(STORE.serialize_cdr(message, kind)), stamp_ns)


def write_cloud(
    writer: BagWriter,
    points: np.ndarray,
    frame_id: str = "base_link",
    stamp_ns: int = START_NS,
    topic: str = "/dgs/cloud",
) -> None:
    """Append a cloud."""
    write(writer, topic, point_cloud(points, frame_id, stamp_ns), stamp_ns)


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

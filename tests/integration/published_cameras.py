"""Cameras as realsense-ros publishes them, from pictures of our own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.time import Time
from sensor_msgs.msg import CameraInfo, Image

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_perception.camera_node import CameraParameters
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info
from dgs_sim_bridge.render.raster import box_mesh
from dgs_sim_bridge.render.shot import Stage, take_shot
from tests.support.ros_client import RosClient

OPTICAL = "camera_depth_optical_frame"
PARAMETERS = CameraParameters()
D455 = PinholeCamera(848, 480, 447.0, 447.0, 423.5, 239.5)
TABLE_STAGE = Stage(
    [], [], (), box_mesh((-1.0, -1.0, CELL.table_height - 0.02), (1.5, 1.0, CELL.table_height))
)


class DepthCamera:
    """Publishes what realsense-ros would: reliable, one camera info beside each image."""

    def __init__(self, client: RosClient) -> None:
        self._depth = client.node.create_publisher(Image, PARAMETERS.depth_topic, 10)
        self._info = client.node.create_publisher(CameraInfo, PARAMETERS.camera_info_topic, 10)
        self._clock = client.node.get_clock()

    def heard(self) -> bool:
        return self._depth.get_subscription_count() > 0 and self._info.get_subscription_count() > 0

    def send(
        self,
        depth: np.ndarray,
        info: PinholeCamera | None = D455,
        change: Callable[[Any], None] = lambda image: None,
        info_change: Callable[[Any], None] = lambda info: None,
    ) -> int:
        stamp = self._clock.now()
        if info is not None:
            message = pinhole_to_camera_info(info, OPTICAL, stamp.to_msg())
            info_change(message)
            self._info.publish(message)
        image = numpy_to_image(depth, OPTICAL, stamp.to_msg())
        change(image)
        self._depth.publish(image)
        return int(stamp.nanoseconds)


class StereoCamera:
    """Publishes a table's infrared pair as realsense-ros would."""

    def __init__(self, client: RosClient) -> None:
        rng = np.random.default_rng(0)
        self._shot = take_shot(TABLE_STAGE, D455, CELL.T_base_camera_optical, None, rng, imagers=2)
        topics = (PARAMETERS.left_topic, PARAMETERS.right_topic)
        self._images = [client.node.create_publisher(Image, topic, 10) for topic in topics]
        topics = (PARAMETERS.camera_info_topic, PARAMETERS.right_info_topic)
        self._infos = [client.node.create_publisher(CameraInfo, topic, 10) for topic in topics]
        self._clock = client.node.get_clock()

    def heard(self) -> bool:
        return all(publisher.get_subscription_count() > 0 for publisher in (*self._images, *self._infos))

    def send(self, baseline: float = 0.095, late: int = 0) -> int:
        stamp = self._clock.now()
        for info, own in zip(self._infos, (0.0, baseline), strict=True):
            info.publish(pinhole_to_camera_info(D455, OPTICAL, stamp.to_msg(), own))
        for publisher, image, delay in zip(
            self._images, (self._shot.left, self._shot.right), (0, late), strict=True
        ):
            moment = Time(nanoseconds=stamp.nanoseconds + delay).to_msg()
            publisher.publish(numpy_to_image(image, "camera_infra1_optical_frame", moment))
        return int(stamp.nanoseconds)

"""Listens during a demo run: pictures of the colour camera, the newest cloud, the simulator's ground truth."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
from dgs_interfaces.msg import SimState
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from dgs_bringup.ros_session import wait_until
from dgs_bringup.truth import TruthTracker
from dgs_description.camera import PinholeCamera
from dgs_ros.image_msgs import camera_info_to_pinhole, colour_to_numpy
from dgs_ros.trajectory_msgs import seconds
from dgs_sim_bridge.render.pictures import caption

COLOUR_TOPIC = "/camera/camera/color/image_raw"
FRAME_PERIOD = 0.5
"""Wall time between two frames of the animation [s]."""
FRAME_WIDTH = 424
MOST_FRAMES = 600
"""Are kept, five minutes at this pace: 180 MB. Of a longer run every second one, at half the pace from then on."""
NEXT = 20.0
"""Pictures and clouds come within so long [s]; a busy machine needs it."""


class RunRecorder:
    """Subscriptions of a session's node, whose callbacks run one after another, and what came in.

    Attributes:
        frames: (H, W, 3) uint8 frames of the animation while `filming`, with `label` written onto them.
        truth: places of the objects.
    """

    def __init__(self, node: Node) -> None:
        self.frames: list[NDArray[np.uint8]] = []
        self.truth = TruthTracker()
        self.label = ""
        self.filming = False
        self._node = node
        self._next_frame, self._period = 0.0, FRAME_PERIOD
        node.create_subscription(Image, COLOUR_TOPIC, self._on_image, qos_profile_sensor_data)
        node.create_subscription(SimState, "/sim/state", self._on_state, 10)

    def picture(self, timeout: float = NEXT) -> NDArray[np.uint8]:
        """The next colour image, (H, W, 3) uint8. Raises TimeoutError."""
        return colour_to_numpy(self._next(Image, COLOUR_TOPIC, timeout))

    def intrinsics(self) -> PinholeCamera:
        """Of the camera; the simulated colour image has those of the depth image. Raises TimeoutError."""
        return camera_info_to_pinhole(self._next(CameraInfo, "/camera/camera/depth/camera_info"))

    def cloud(self) -> PointCloud2:
        """The next cloud. Raises TimeoutError."""
        return self._next(PointCloud2, "/dgs/cloud")

    def _next(self, kind: Any, topic: str, timeout: float = NEXT) -> Any:
        """The next message of a topic; subscribed to only meanwhile, for clouds are large."""
        came: list[Any] = []
        subscription = self._node.create_subscription(kind, topic, came.append, qos_profile_sensor_data)
        try:
            if not wait_until(lambda: came, timeout):
                raise TimeoutError(f"nothing on {topic} within {timeout:g} s")
        finally:
            self._node.destroy_subscription(subscription)
        return came[0]

    def _on_image(self, message: Image) -> None:
        if not self.filming or time.monotonic() < self._next_frame:
            return
        if len(self.frames) == MOST_FRAMES:
            del self.frames[1::2]
            self._period *= 2
        self._next_frame = time.monotonic() + self._period
        image = colour_to_numpy(message)
        height = round(FRAME_WIDTH * image.shape[0] / image.shape[1])
        small = cv2.resize(image, (FRAME_WIDTH, height), interpolation=cv2.INTER_AREA)
        self.frames.append(caption(small, self.label))

    def _on_state(self, message: SimState) -> None:
        self.truth.update(seconds(message.header.stamp), message.names, message.places)

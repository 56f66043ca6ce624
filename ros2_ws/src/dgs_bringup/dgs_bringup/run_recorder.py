"""Listens during a demo run: pictures of the colour camera, the newest cloud, the simulator's ground truth."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from dgs_interfaces.msg import SimState
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from dgs_bringup.truth import TruthTracker
from dgs_description.camera import PinholeCamera
from dgs_ros.image_msgs import camera_info_to_pinhole, colour_to_numpy
from dgs_sim_bridge.render.pictures import caption

COLOUR_TOPIC = "/camera/camera/color/image_raw"
COLOUR_INFO_TOPIC = "/camera/camera/color/camera_info"
DEPTH_INFO_TOPIC = "/camera/camera/depth/camera_info"
CLOUD_TOPIC = "/dgs/cloud"
STATE_TOPIC = "/sim/state"
FRAME_PERIOD = 0.5
"""Wall time between two frames of the animation [s]."""
FRAME_WIDTH = 424

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


class RunRecorder:
    """Subscriptions of one node and what came in.

    Attributes:
        frames: (H, W, 3) uint8 frames of the animation while `filming`.
        truth: places of the objects; guarded by `lock`.
        label: written onto the frames.
        filming: whether frames are kept.
    """

    def __init__(self, node: Node) -> None:
        """Subscribe."""
        self.frames: list[NDArray[np.uint8]] = []
        self.truth = TruthTracker()
        self.lock = threading.Lock()
        self.label = ""
        self.filming = False
        self._node = node
        self._next_frame = 0.0
        self._newest: dict[str, Any] = {}
        subscriptions: tuple[tuple[Any, str, Callable[[Any], None], Any], ...] = (
            (Image, COLOUR_TOPIC, self._on_image, _NEWEST),
            (CameraInfo, DEPTH_INFO_TOPIC, self._keep(DEPTH_INFO_TOPIC), _NEWEST),
            (CameraInfo, COLOUR_INFO_TOPIC, self._keep(COLOUR_INFO_TOPIC), _NEWEST),
            (SimState, STATE_TOPIC, self._on_state, 10),
        )
        for kind, topic, callback, qos in subscriptions:
            group = MutuallyExclusiveCallbackGroup()
            node.create_subscription(kind, topic, callback, qos, callback_group=group)

    def picture(self, timeout: float = 20.0) -> NDArray[np.uint8]:
        """The next colour image, (H, W, 3) uint8. Raises TimeoutError."""
        return colour_to_numpy(self._next(COLOUR_TOPIC, timeout))

    def intrinsics(self, timeout: float = 20.0) -> PinholeCamera:
        """Of the colour camera, or of the depth camera if the colour camera does not say. Raises TimeoutError."""
        self._wait(
            lambda: {COLOUR_INFO_TOPIC, DEPTH_INFO_TOPIC} & self._newest.keys(), "camera info", timeout
        )
        info = self._newest.get(COLOUR_INFO_TOPIC) or self._newest[DEPTH_INFO_TOPIC]
        return camera_info_to_pinhole(info)

    def cloud(self, timeout: float = 20.0) -> PointCloud2:
        """The next cloud; subscribed to only now, for clouds are large. Raises TimeoutError."""
        self._newest.pop(CLOUD_TOPIC, None)
        subscription = self._node.create_subscription(
            PointCloud2, CLOUD_TOPIC, self._keep(CLOUD_TOPIC), qos_profile_sensor_data
        )
        try:
            return self._next(CLOUD_TOPIC, timeout)
        finally:
            self._node.destroy_subscription(subscription)

    def _next(self, topic: str, timeout: float) -> Any:
        self._newest.pop(topic, None)
        self._wait(lambda: topic in self._newest, topic, timeout)
        return self._newest[topic]

    def _wait(self, condition: Callable[[], Any], what: str, timeout: float) -> None:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError(f"nothing on {what} within {timeout:g} s")
            time.sleep(0.02)

    def _keep(self, topic: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            self._newest[topic] = message

        return keep

    def _on_image(self, message: Image) -> None:
        self._newest[COLOUR_TOPIC] = message
        if not self.filming or time.monotonic() < self._next_frame:
            return
        self._next_frame = time.monotonic() + FRAME_PERIOD
        image = colour_to_numpy(message)
        height = round(FRAME_WIDTH * image.shape[0] / image.shape[1])
        small = cv2.resize(image, (FRAME_WIDTH, height), interpolation=cv2.INTER_AREA)
        self.frames.append(caption(small, self.label))

    def _on_state(self, message: SimState) -> None:
        stamp = message.header.stamp
        with self.lock:
            self.truth.update(stamp.sec + stamp.nanosec * 1e-9, message.names, message.places)

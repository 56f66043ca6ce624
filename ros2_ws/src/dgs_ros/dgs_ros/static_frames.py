"""Fixed frames, as /tf_static tells of them."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage

from dgs_description.errors import DgsError
from dgs_description.frame_tree import FrameTree
from dgs_ros.pose_msgs import transform_to_matrix

TF_STATIC = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class StaticFrames(FrameTree):
    """The tree of fixed frames that a node has heard of."""

    def __init__(self, node: Node, told: Callable[[str], None] = lambda frame: None):
        """`told`: is called with every frame's name, without leading slash, once its pose is known."""
        super().__init__()
        self._logger, self._told = node.get_logger(), told
        node.create_subscription(TFMessage, "/tf_static", self._on_transforms, TF_STATIC)

    def _on_transforms(self, message: TFMessage) -> None:
        for item in message.transforms:
            try:
                pose = transform_to_matrix(item.transform)
            except DgsError as error:
                self._logger.warning(f"/tf_static: {item.child_frame_id} ignored, {error.message}")
                continue
            self.set(item.header.frame_id, item.child_frame_id, pose)
            self._told(item.child_frame_id.lstrip("/"))

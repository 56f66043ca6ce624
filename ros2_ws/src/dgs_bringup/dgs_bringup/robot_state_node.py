"""Tells tools where every link is: /robot_description, and /tf from the joint states of arm and hand.

What robot_state_publisher does, for a machine that has none, and for two topics of joint states at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from dgs_description.errors import DgsError
from dgs_description.frames import CAMERA_LINK, CAMERA_OPTICAL
from dgs_description.link_tree import LinkTree
from dgs_description.parameters import parameter
from dgs_description.urdf import cell, urdf_text
from dgs_ros.base_node import LATCHED, DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import positions_of
from dgs_ros.pose_msgs import matrix_to_transform
from dgs_ros.run import run
from dgs_ros.trajectory_msgs import seconds

_OTHERS = (CAMERA_LINK, CAMERA_OPTICAL)
"""Frames that the camera node knows better."""


@dataclass(frozen=True)
class RobotStateParameters:
    """See the description."""

    rate: float = parameter(30.0, "Most transforms per second and joint [Hz of the stamps].", 1.0, 500.0)


class RobotStateNode(DgsNode[RobotStateParameters]):
    """Turns joint states into transforms."""

    def __init__(self, **node_arguments: Any) -> None:
        """Publish the description and the fixed frames; the others follow the joints."""
        super().__init__("robot_state", RobotStateParameters, **node_arguments)
        tree = LinkTree(cell())
        self._moving = {joint.name: joint.child for joint in tree.moving}
        self._tree = tree
        self._last: dict[str, float] = {}
        self._description = self.create_publisher(String, "/robot_description", LATCHED)
        self._fixed_frames = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._frames = self.create_publisher(TFMessage, "/tf", 100)
        self._description.publish(String(data=urdf_text("cell_ros")))
        fixed = [
            matrix_to_transform(pose, parent, child)
            for child, (parent, pose) in tree.transforms({}).items()
            if child not in (*self._moving.values(), *_OTHERS)
        ]
        self._fixed_frames.publish(TFMessage(transforms=fixed))
        for topic in ("/joint_states", "/dexhand/joint_states"):
            self.create_subscription(JointState, topic, self._on_joints, QoSProfile(depth=5))
        self.report(Level.OK, f"{len(fixed)} fixed and {len(self._moving)} moving frames")

    def _on_joints(self, message: JointState) -> None:
        known = [name for name in message.name if name in self._moving]
        if not known or not self._due(known[0], seconds(message.header.stamp)):
            return
        try:
            angles = dict(zip(known, positions_of(message, known).tolist(), strict=True))
        except DgsError as error:
            self.report_event(Level.WARN, error.message, "joints", code=int(error.code))
            return
        self._frames.publish(TFMessage(transforms=self._transforms(angles, message.header.stamp)))

    def _due(self, joint: str, stamp: float) -> bool:
        """Whether the topic that a joint comes on is to be looked at again; after a reset of the clock it is."""
        passed = stamp - self._last.get(joint, -1e9)
        if 0 <= passed < 0.99 / self.parameters.rate:
            return False
        self._last[joint] = stamp
        return True

    def _transforms(self, angles: dict[str, float], stamp: Time) -> list[Any]:
        placed = self._tree.transforms(angles)
        children = [self._moving[name] for name in angles]
        return [matrix_to_transform(placed[child][1], placed[child][0], child, stamp) for child in children]


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_bringup robot_state`."""
    run(RobotStateNode, args)

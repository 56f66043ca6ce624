"""Tells tools where every link is: /robot_description, and /tf from the joint states of arm and hand.

What robot_state_publisher does, for a machine that has none, and for two topics of joint states at once.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from rclpy.qos import QoSProfile
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from dgs_description.cell import CELL
from dgs_description.errors import DgsError
from dgs_description.frames import CAMERA_LINK, Array
from dgs_description.link_tree import LinkTree
from dgs_description.parameters import parameter
from dgs_description.urdf import cell, urdf_text
from dgs_ros.base_node import LATCHED, DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import positions_of
from dgs_ros.pose_msgs import matrix_to_transform
from dgs_ros.run import run
from dgs_ros.trajectory_msgs import seconds

_OTHERS = (CAMERA_LINK, CELL.optical_frame)
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
        at_rest = tree.transforms({})
        self._rows = {joint.name: row for row, joint in enumerate(tree.moving)}
        self._axes = np.array([joint.axis for joint in tree.moving])
        self._at_zero = Rotation.from_matrix([at_rest[joint.child][1][:3, :3] for joint in tree.moving])
        # A joint turns its frame in place: messages are made once, and only their rotation and stamp change.
        self._turning = [
            matrix_to_transform(at_rest[joint.child][1], joint.parent, joint.child) for joint in tree.moving
        ]
        self._last: dict[str, float] = {}
        self._description = self.create_publisher(String, "/robot_description", LATCHED)
        self._fixed_frames = self.create_publisher(TFMessage, "/tf_static", LATCHED)
        self._frames = self.create_publisher(TFMessage, "/tf", 100)
        self._description.publish(String(data=urdf_text("cell_ros")))
        fixed = [
            matrix_to_transform(pose, parent, child)
            for child, (parent, pose) in at_rest.items()
            if child not in (*(joint.child for joint in tree.moving), *_OTHERS)
        ]
        self._fixed_frames.publish(TFMessage(transforms=fixed))
        for topic in ("/joint_states", "/dexhand/joint_states"):
            self.create_subscription(JointState, topic, self._on_joints, QoSProfile(depth=5))
        self.report(Level.OK, f"{len(fixed)} fixed and {len(self._rows)} moving frames")

    def _on_joints(self, message: JointState) -> None:
        known = [name for name in message.name if name in self._rows]
        if not known or not self._due(known[0], seconds(message.header.stamp)):
            return
        try:
            angles = positions_of(message, known)
        except DgsError as error:
            self.report_event(Level.WARN, error.message, "joints", code=int(error.code))
            return
        rows = [self._rows[name] for name in known]
        self._frames.publish(TFMessage(transforms=self._transforms(rows, angles, message.header.stamp)))

    def _due(self, joint: str, stamp: float) -> bool:
        """Whether the topic that a joint comes on is to be looked at again; after a reset of the clock it is."""
        passed = stamp - self._last.get(joint, -1e9)
        if 0 <= passed < 0.99 / self.parameters.rate:
            return False
        self._last[joint] = stamp
        return True

    def _transforms(self, rows: list[int], angles: Array, stamp: Time) -> list[Any]:
        turned = self._at_zero[rows] * Rotation.from_rotvec(angles[:, None] * self._axes[rows])
        transforms = [self._turning[row] for row in rows]
        for item, (x, y, z, w) in zip(transforms, turned.as_quat().tolist(), strict=True):
            rotation = item.transform.rotation
            rotation.x, rotation.y, rotation.z, rotation.w = x, y, z, w
            item.header.stamp = stamp
        return transforms


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_bringup robot_state`; who picks goes first."""
    os.nice(10)
    run(RobotStateNode, args)

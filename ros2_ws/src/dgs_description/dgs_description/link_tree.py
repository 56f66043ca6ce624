"""Where every link of a robot description is at given joint angles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array, from_rpy, transform
from dgs_description.urdf_writer import Robot


class LinkTree:
    """Forward kinematics of a `Robot`, link by link.

    Attributes:
        root: name of the link that all others hang from.
        moving: joints that turn, parents first.
    """

    def __init__(self, robot: Robot) -> None:
        """Raises ValueError if a joint hangs from a link that no joint before it leads to."""
        self.root = robot.links[0].name
        self._joints = robot.joints
        known = {self.root}
        for joint in self._joints:
            if joint.parent not in known:
                raise ValueError(f"the joint {joint.name} hangs from no link before it")
            known.add(joint.child)
        self._offsets = [from_rpy(joint.xyz, joint.rpy) for joint in self._joints]
        self.moving = [joint for joint in self._joints if joint.axis is not None]

    def transforms(self, angles: Mapping[str, float]) -> dict[str, tuple[str, Array]]:
        """By child link: its parent, and T_parent_child (4, 4) [m] at joint angles [rad].

        A joint that is not named stands at that of its `mimic`, or at 0.
        """
        placed = {}
        for joint, offset in zip(self._joints, self._offsets, strict=True):
            turn = offset
            if joint.axis is not None:
                angle = angles.get(joint.name, 0.0)
                if joint.mimic is not None and joint.name not in angles:
                    angle = joint.mimic.multiplier * angles.get(joint.mimic.joint, 0.0)
                rotation = Rotation.from_rotvec(angle * np.asarray(joint.axis, np.float64))
                turn = offset @ transform(rotation.as_matrix())
            placed[joint.child] = joint.parent, turn
        return placed

    def poses(self, angles: Mapping[str, float]) -> dict[str, Array]:
        """T_root_link (4, 4) [m] of every link at joint angles [rad], as `transforms` reads them."""
        poses = {self.root: np.eye(4)}
        for child, (parent, T_parent_child) in self.transforms(angles).items():
            poses[child] = poses[parent] @ T_parent_child
        return poses

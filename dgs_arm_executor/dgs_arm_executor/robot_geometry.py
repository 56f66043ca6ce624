"""Collision shapes of arm, hand and cell from the URDF, and which pairs of them are checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_description.frames import HAND_BASE, TOOL0
from dgs_description.hand_model import link_frames
from dgs_description.joints import FINGERS, HAND_JOINTS
from dgs_description.urdf import urdf_path

Array = NDArray[np.float64]

HAND = "hand"
TABLE = "table"
ENVIRONMENT = (TABLE, "pedestal", "bin", "camera_stand", "camera_link")
"""What stands in the cell. The arm's foot, `base_link_inertia`, counts as arm."""

_PHALANGES = ("knuckle", "proximal", "middle", "distal")

# Pairs that are never checked: neighbours in the chain, which touch by design, and pairs that the links' lengths keep
# apart in every posture (0 contacts in 6000 random postures with random fingers).
_NEIGHBOURS = (
    ("base_link_inertia", "shoulder_link"),
    ("shoulder_link", "upper_arm_link"),
    ("upper_arm_link", "forearm_link"),
    ("forearm_link", "wrist_1_link"),
    ("wrist_1_link", "wrist_2_link"),
    ("wrist_2_link", "wrist_3_link"),
    ("wrist_3_link", HAND),
)
_NEVER = (
    ("base_link_inertia", "upper_arm_link"),
    ("wrist_1_link", "wrist_3_link"),
    ("wrist_1_link", HAND),
    ("wrist_2_link", HAND),
    *(("shoulder_link", thing) for thing in ENVIRONMENT),
    *(("base_link_inertia", thing) for thing in ENVIRONMENT),
)
DISABLED_PAIRS = frozenset(frozenset(pair) for pair in (*_NEIGHBOURS, *_NEVER))


@dataclass(frozen=True)
class RobotGeometry:
    """Arm model and shapes, the hand's fingers being movable by `place_fingers`.

    Attributes:
        model: Pinocchio model with the six arm joints; the hand is rigid for it.
        shapes: all collision shapes, without pairs.
        parts: name of the part (link, or `hand` for palm and fingers) per shape.
        finger_shapes: per finger shape its index, finger, link (0 knuckle .. 3 distal) and placement in that link.
    """

    model: pin.Model
    shapes: pin.GeometryModel
    parts: tuple[str, ...]
    finger_shapes: tuple[tuple[int, int, int, pin.SE3], ...]

    def indices(self, part: str) -> list[int]:
        """Shape indices of a part."""
        return [i for i, name in enumerate(self.parts) if name == part]

    def place_fingers(self, shapes: pin.GeometryModel, hand_joints: ArrayLike) -> None:
        """Put the finger shapes of `shapes` (a copy of `self.shapes`) where (20,) hand joints [rad] have them."""
        T_tcp_link = link_frames(np.asarray(hand_joints, float).reshape(20))
        T_joint_tool0 = self.model.frames[self.model.getFrameId(TOOL0)].placement
        for index, finger, link, T_link_shape in self.finger_shapes:
            T_tool0_link = pin.SE3(T_TOOL0_TCP @ T_tcp_link[finger, link])
            shapes.geometryObjects[index].placement = T_joint_tool0 * T_tool0_link * T_link_shape


@cache
def load_robot_geometry() -> RobotGeometry:
    """Shapes of the cell's URDF, which is read once."""
    path = str(urdf_path("cell"))
    full = pin.buildModelFromUrdf(path)
    all_shapes = pin.buildGeomFromUrdf(full, path, pin.GeometryType.COLLISION)
    # Shape index -> its finger link; the placements in those links are lost when the hand gets locked.
    local: list[tuple[int, int, int, pin.SE3]] = []
    parts = []
    for index, shape in enumerate(all_shapes.geometryObjects):
        link = shape.name.rsplit("_", 1)[0]
        first, _, second = link.partition("_")
        is_finger = first in FINGERS and second in _PHALANGES
        if is_finger:
            T_link_shape = full.frames[shape.parentFrame].placement.inverse() * shape.placement
            local.append((index, FINGERS.index(first), _PHALANGES.index(second), T_link_shape))
        parts.append(HAND if is_finger or link == HAND_BASE else link)
    locked = [full.getJointId(name) for name in HAND_JOINTS]
    model, (shapes,) = pin.buildReducedModel(full, [all_shapes], locked, pin.neutral(full))
    return RobotGeometry(model, shapes, tuple(parts), tuple(local))


def checked_pairs(geometry: RobotGeometry) -> list[tuple[str, str]]:
    """Pairs of parts that are checked: self collision, then robot against environment."""
    moving = list(dict.fromkeys(name for name in geometry.parts if name not in ENVIRONMENT))
    pairs = list(combinations(moving, 2))
    pairs += [(a, b) for a in moving for b in ENVIRONMENT]
    return [pair for pair in pairs if frozenset(pair) not in DISABLED_PAIRS]

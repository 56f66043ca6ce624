"""Collision shapes of arm, hand and cell from the URDF, and which pairs of them are checked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from dgs_description.frames import HAND_BASE, Array
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.urdf import urdf_path, urdf_text

WHOLE_HAND = "hand"
TABLE = "table"
ENVIRONMENT = (TABLE, "pedestal", "bin", "camera_stand", "camera_link")
"""What stands in the cell. The arm's foot, `base_link_inertia`, counts as arm."""

CHAIN = (
    "base_link_inertia", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link",
    "wrist_3_link", WHOLE_HAND,
)  # fmt: skip
"""The robot's parts from foot to hand."""

# Pairs that are never checked: neighbours in the chain, which touch by design, and pairs that the links' lengths keep
# apart in every posture (0 contacts in 6000 random postures with random fingers).
_NEVER = (
    ("base_link_inertia", "upper_arm_link"),
    ("wrist_1_link", "wrist_3_link"),
    ("wrist_1_link", WHOLE_HAND),
    ("wrist_2_link", WHOLE_HAND),
    *(("shoulder_link", thing) for thing in ENVIRONMENT),
    *(("base_link_inertia", thing) for thing in ENVIRONMENT),
)
DISABLED_PAIRS = frozenset(frozenset(pair) for pair in (*pairwise(CHAIN), *_NEVER))


@dataclass(frozen=True)
class RobotGeometry:
    """Arm, hand and cell as the URDF has them.

    Attributes:
        model: Pinocchio model with the joints of arm and hand.
        shapes: all collision shapes, without pairs.
        parts: name of the part (link, or `hand` for palm and fingers) per shape.
    """

    model: pin.Model
    shapes: pin.GeometryModel
    parts: tuple[str, ...]

    def with_hand(self, hand_joints: ArrayLike) -> tuple[pin.Model, pin.GeometryModel]:
        """Model of the arm alone, the hand being rigid at (J,) joints [rad], and all shapes in the same order."""
        posture = pin.neutral(self.model)
        locked = [self.model.getJointId(name) for name in HAND.joints]
        posture[[self.model.joints[joint].idx_q for joint in locked]] = np.asarray(hand_joints, float)
        arm, (shapes,) = pin.buildReducedModel(self.model, [self.shapes], locked, posture)
        return arm, shapes


@cache
def load_robot_geometry() -> RobotGeometry:
    """The cell's URDF, which is read once."""
    path = str(urdf_path("cell"))
    model = pin.buildModelFromUrdf(path)
    shapes = pin.buildGeomFromUrdf(model, path, pin.GeometryType.COLLISION)
    links = [shape.name.rsplit("_", 1)[0] for shape in shapes.geometryObjects]
    parts = (
        WHOLE_HAND if link == HAND_BASE or link.split("_")[0] in HAND.fingers else link for link in links
    )
    return RobotGeometry(model, shapes, tuple(parts))


@cache
def hand_inertia() -> tuple[float, Array]:
    """Mass [kg] and centre of gravity (3,) in `tool0` [m] of the hand's model, its joints at zero; no adapter."""
    model = pin.buildModelFromXML(urdf_text("dexhand"), pin.JointModelFreeFlyer())
    data = model.createData()
    centre = pin.centerOfMass(model, data, pin.neutral(model))
    return float(data.mass[0]), np.array(centre)


def model_order(arm: pin.Model) -> list[int]:
    """Which of `ARM_JOINTS` each joint of an arm's model is: `q[model_order(arm)]` is what Pinocchio takes."""
    return [ARM_JOINTS.index(name) for name in arm.names[1:]]


def checked_pairs(geometry: RobotGeometry) -> list[tuple[str, str]]:
    """Pairs of parts that are checked: self collision, then robot against environment."""
    moving = list(dict.fromkeys(name for name in geometry.parts if name not in ENVIRONMENT))
    pairs = list(combinations(moving, 2))
    pairs += [(a, b) for a in moving for b in ENVIRONMENT]
    return [pair for pair in pairs if frozenset(pair) not in DISABLED_PAIRS]

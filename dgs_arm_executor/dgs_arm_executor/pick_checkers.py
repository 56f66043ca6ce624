"""A grasp before it is planned: whether it is one at all, and the collision checkers of what it passes through."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial

import numpy as np

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene
from dgs_arm_executor.situation import Load
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

_LIMIT_TOLERANCE = 0.02
"""Hand joints this far outside of their limits are clipped, not refused [rad]."""


_invalid = partial(DgsError, ErrorCode.GRASP_INVALID)


class PickCheckers:
    """Collision checkers of the situations that one grasp passes through, each built when it is first needed.

    Attributes:
        load: the grasp, and what the hand will hold after the lift.
    """

    def __init__(self, scene: PlanningScene, grasp: GraspSet, hand_joints: Array = HAND.open_hand):
        """`hand_joints`: (J,) of the hand before it takes the pre-grasp shape [rad]."""
        self._scene, self._grasp, self._hand_joints = scene, grasp, hand_joints
        self._released, self._gone = scene.cloud.target_mask(grasp), scene.cloud.carried_mask(grasp)
        self.load = Load(
            grasp, CarriedBox.from_points(scene.cloud.points[self._released], grasp.closing_pose)
        )

    @cached_property
    def transfer(self) -> CollisionChecker:
        """Pre-grasp shape, well away from all of the cloud."""
        clearance = self._scene.settings.transfer_clearance
        return self._scene.checker(self._grasp.pre_grasp_joints, cloud_clearance=clearance)

    @cached_property
    def shaping(self) -> tuple[CollisionChecker, ...]:
        """As `transfer`, with the hand as it is, and half way to the pre-grasp shape."""
        before, clearance = self._hand_joints, self._scene.settings.transfer_clearance
        shapes = before, (before + self._grasp.pre_grasp_joints) / 2
        return tuple(self._scene.checker(shape, cloud_clearance=clearance) for shape in shapes)

    @cached_property
    def approach(self) -> CollisionChecker:
        """Pre-grasp shape, the target released."""
        return self._scene.checker(self._grasp.pre_grasp_joints, released=self._released)

    @cached_property
    def lift(self) -> CollisionChecker:
        """Closed hand, which may touch the table, the target released."""
        return self._scene.checker(self._grasp.grasp_joints, released=self._released, hand_on_table=True)

    @cached_property
    def carry(self) -> CollisionChecker:
        """Closed hand with the object.

        What touches the target may be a part of it, which goes along, or something that stays: the hand keeps clear.
        """
        shape, box = self._grasp.grasp_joints, self.load.box
        return self._scene.checker(shape, released=self._released, carried=box, own=self._gone)

    @cached_property
    def home(self) -> CollisionChecker:
        """Open hand, the object gone; after a push, the hand as it pushed, after a drag, as it came."""
        shape = HAND.open_hand if self._grasp.holds else self._grasp.pre_grasp_joints
        return self._scene.checker(shape, released=self._released)


def check_grasp(grasp: GraspSet) -> GraspSet:
    """One grasp with its joints clipped to the limits.

    Raises:
        DgsError: GRASP_INVALID if a number is not finite, the rotation is none, no finger takes part and nothing moves,
            or a joint is far out of its limits.
    """
    numbers = (grasp.pose, grasp.motion, grasp.reference_point, grasp.pre_grasp_joints, grasp.grasp_joints)
    if not all(np.isfinite(values).all() for values in numbers):
        raise _invalid("the grasp holds numbers that are not finite")
    skew = np.abs(grasp.rotation @ grasp.rotation.T - np.eye(3)).max()
    if skew > 1e-3 or np.linalg.det(grasp.rotation) < 0:
        raise _invalid("the grasp's orientation is not a rotation")
    if not grasp.holds and not grasp.motion.any():
        raise _invalid("the grasp's active_fingers name no finger that closes to lift, and it has no motion")
    if grasp.drags and not grasp.active_fingers.any():
        raise _invalid("the grasp drags, but its active_fingers name no finger that closes")
    before = _within_limits("pre-grasp", grasp.pre_grasp_joints)
    return replace(grasp, pre_grasp_joints=before, grasp_joints=_within_limits("grasp", grasp.grasp_joints))


def _within_limits(shape: str, joints: Array) -> Array:
    excess = np.maximum(HAND.lower - joints, joints - HAND.upper).max()
    if excess > _LIMIT_TOLERANCE:
        raise _invalid(f"a hand joint of the {shape} is {excess:.3f} rad beyond its limit")
    return np.clip(joints, HAND.lower, HAND.upper)

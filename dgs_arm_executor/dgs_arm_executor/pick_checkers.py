"""Collision checkers of the situations that one pick passes through."""

from __future__ import annotations

from functools import cached_property

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene
from dgs_arm_executor.situation import Load
from dgs_description.grasp import GraspSet
from dgs_description.pick import OPEN_HAND


class PickCheckers:
    """Collision checkers of the situations that one grasp passes through, each built when it is first needed.

    Attributes:
        load: the grasp, and what the hand will hold after the lift.
    """

    def __init__(self, scene: PlanningScene, grasp: GraspSet):
        self._scene, self._grasp = scene, grasp
        self._released = scene.cloud.target_mask(grasp)
        self.load = Load(grasp, CarriedBox.from_points(scene.cloud.points[self._released], grasp.pose))

    @cached_property
    def transfer(self) -> CollisionChecker:
        """Pre-grasp shape, well away from all of the cloud."""
        clearance = self._scene.settings.transfer_clearance
        return self._scene.checker(self._grasp.pre_grasp_joints, cloud_clearance=clearance)

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
        """Closed hand with the object."""
        return self._scene.checker(self._grasp.grasp_joints, released=self._released, carried=self.load.box)

    @cached_property
    def home(self) -> CollisionChecker:
        """Open hand, the object gone."""
        return self._scene.checker(OPEN_HAND, released=self._released)

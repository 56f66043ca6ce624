"""Collision checkers of the situations that one pick passes through."""

from __future__ import annotations

from functools import cached_property

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_types import OPEN_HAND, Candidate
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene, Situation


class PickCheckers:
    """Collision checkers of the situations that a candidate passes through, each built when it is first needed."""

    def __init__(self, scene: PlanningScene, candidate: Candidate):
        T_grasp = candidate.T_base_tcp
        self._scene, self._candidate = scene, candidate
        self._released = scene.cloud.target_mask(candidate.reference_point, T_grasp[:3, 3])
        self.carried = CarriedBox.from_points(scene.cloud.points[self._released], T_grasp)

    @cached_property
    def transfer(self) -> CollisionChecker:
        """Pre-grasp shape, well away from all of the cloud."""
        clearance = self._scene.settings.transfer_clearance
        return self._scene.checker(Situation(self._candidate.pre_grasp_joints, cloud_clearance=clearance))

    @cached_property
    def approach(self) -> CollisionChecker:
        """Pre-grasp shape, the target released."""
        return self._scene.checker(Situation(self._candidate.pre_grasp_joints, self._released))

    @cached_property
    def lift(self) -> CollisionChecker:
        """Closed hand, which may touch the table, the target released."""
        closed = self._candidate.grasp_joints
        return self._scene.checker(Situation(closed, self._released, hand_on_table=True))

    @cached_property
    def carry(self) -> CollisionChecker:
        """Closed hand with the object."""
        return self._scene.checker(Situation(self._candidate.grasp_joints, self._released, self.carried))

    @cached_property
    def home(self) -> CollisionChecker:
        """Open hand, the object gone."""
        return self._scene.checker(Situation(OPEN_HAND, self._released))

"""What the pick planner is compared with: OMPL's RRT-Connect as it comes, grasp after grasp."""

from __future__ import annotations

import numpy as np

from dgs_arm_executor.cartesian import track_line
from dgs_arm_executor.paths import rrt_connect
from dgs_arm_executor.pick_candidate import pick_lines
from dgs_arm_executor.pick_checkers import PickCheckers
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.planning_scene import PlanningScene, SceneSettings
from dgs_arm_executor.release import release_states
from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet

TIMEOUT = 1.0
"""Processor time of one query [s]; MoveIt's common setting is 5 s of wall time."""


class Baseline:
    """Per grasp in the order of scores: the nearest free IK solution of the stand-off, RRT-Connect, simplification.

    The collision checks, the straight lines and the release poses are those of the pick planner; the choice of the IK
    branch, the paths and the absence of a time parametrisation are not.
    """

    def __init__(self, planner: PickPlanner, situation: ArmSituation):
        """Take the IK and the geometry of a pick planner."""
        self._planner, self._start = planner, situation.arm_joints
        self._scene = PlanningScene(situation.cloud, SceneSettings(transfer_clearance=0.0))

    def to_stand_off(self, grasps: GraspSet) -> int | None:
        """Index of the first grasp with a path to its stand-off, or None; nothing after it is looked at."""
        return next((k for k in range(len(grasps)) if self._transfer(grasps[k]) is not None), None)

    def whole_pick(self, grasps: GraspSet) -> int | None:
        """Index of the first grasp that also has a free approach and lift, and paths to the bin and home."""
        return next((k for k in range(len(grasps)) if self._pick_and_place(grasps[k])), None)

    def _transfer(self, grasp: GraspSet) -> Array | None:
        """The stand-off (6,) [rad] that a path leads to, or None."""
        checker = self._scene.checker(grasp.pre_grasp_joints)
        states = self._planner.ik.states(self._planner.settings.backed_off(grasp.pose), self._start)
        order = np.argsort(np.linalg.norm(states - self._start, axis=1), kind="stable")
        goal = next((q for q in states[order] if not checker.in_collision(q)), None)
        if goal is None or rrt_connect(checker, self._start, goal, timeout=TIMEOUT) is None:
            return None
        return goal

    def _pick_and_place(self, grasp: GraspSet) -> bool:
        planner, stand_off = self._planner, self._transfer(grasp)
        settings = planner.settings
        if stand_off is None:
            return False
        checkers = PickCheckers(self._scene, grasp)
        try:
            back = settings.backed_off(grasp.pose)
            approach = track_line(planner.ik, back, grasp.pose, stand_off).joints
            lifted = pick_lines(planner.ik, settings, approach[-1], checkers).lift.joints[-1]
        except DgsError:
            return False
        states = release_states(planner.ik, checkers.load.box, lifted, settings)
        free = (q for q in states if not checkers.carry.in_collision(q) and not checkers.home.in_collision(q))
        over = next(free, None)
        if over is None or rrt_connect(checkers.carry, lifted, over, timeout=TIMEOUT) is None:
            return False
        return rrt_connect(checkers.home, over, planner.home, timeout=TIMEOUT) is not None

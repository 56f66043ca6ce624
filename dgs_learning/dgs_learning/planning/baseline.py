"""What the pick planner is compared with: OMPL's RRT-Connect as it comes, candidate after candidate."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob
from ompl import geometric as og

from dgs_arm_executor.cartesian import track_line
from dgs_arm_executor.ik import T_TCP_TOOL0, ArmIK, nearest_turn
from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.pick_types import OPEN_HAND, Candidate, PickSettings
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene, Situation
from dgs_arm_executor.release import release_poses, release_states
from dgs_description.errors import DgsError
from dgs_description.frames import transform

Array = NDArray[np.float64]

TIMEOUT = 1.0
"""Processor time of one query [s]; MoveIt's common setting is 5 s of wall time."""


class Baseline:
    """Per candidate in the order of scores: the nearest free IK solution of the stand-off, RRT-Connect, simplification.

    The collision checks, the straight lines and the release poses are those of the pick planner; the choice of the IK
    branch, the paths and the absence of a time parametrisation are not.
    """

    def __init__(self, ik: ArmIK, settings: PickSettings, cloud: ObstacleCloud):
        self._ik, self._settings = ik, settings
        self._scene = PlanningScene(cloud)

    def to_stand_off(self, start: Array, candidates: Sequence[Candidate]) -> int | None:
        """Index of the first candidate with a path to its stand-off, or None; nothing after it is looked at.

        Args:
            start: (6,) arm joints [rad].
            candidates: best first.
        """
        return next((c.index for c in candidates if self._transfer(start, c) is not None), None)

    def whole_pick(self, start: Array, candidates: Sequence[Candidate]) -> int | None:
        """Index of the first candidate that also has a free approach and lift, and paths to the bin and home."""
        for candidate in candidates:
            stand_off = self._transfer(start, candidate)
            if stand_off is not None and self._pick_and_place(candidate, stand_off):
                return candidate.index
        return None

    def _transfer(self, start: Array, candidate: Candidate) -> Array | None:
        """The stand-off (6,) [rad] that a path leads to, or None."""
        checker = self._scene.checker(Situation(candidate.pre_grasp_joints))
        found = self._ik.branches((self._stand_off(candidate) @ T_TCP_TOOL0)[None], wrist_3=float(start[5]))[
            0
        ]
        states = nearest_turn(found, start, self._ik.lower, self._ik.upper)
        states = states[~np.isnan(states).any(1)]
        order = np.argsort(np.linalg.norm(states - start, axis=1), kind="stable")
        goal = next((q for q in states[order] if not checker.in_collision(q)), None)
        return goal if goal is not None and self._rrt_connect(checker, start, goal) else None

    def _pick_and_place(self, candidate: Candidate, stand_off: Array) -> bool:
        T_grasp, closed = candidate.T_base_tcp, candidate.grasp_joints
        cloud = self._scene.cloud
        released = cloud.target_mask(candidate.reference_point, T_grasp[:3, 3])
        carried = CarriedBox.from_points(cloud.points[released], T_grasp)
        try:
            approach = track_line(self._ik, self._stand_off(candidate), T_grasp, stand_off).joints
            up = transform(position=(0.0, 0.0, self._settings.lift))
            lift = track_line(self._ik, T_grasp, up @ T_grasp, approach[-1]).joints
        except DgsError:
            return False
        for situation, line in (
            (Situation(candidate.pre_grasp_joints, released), approach),
            (Situation(closed, released, hand_on_table=True), lift),
        ):
            if self._scene.checker(situation).first_collision(line) is not None:
                return False
        carry = self._scene.checker(Situation(closed, released, carried))
        home = self._scene.checker(Situation(OPEN_HAND, released))
        poses = release_poses(self._settings.cell, carried, self._settings.release_clearance)
        states = release_states(self._ik, poses, lift[-1])
        over = next((q for q in states if not carry.in_collision(q) and not home.in_collision(q)), None)
        if over is None or not self._rrt_connect(carry, lift[-1], over):
            return False
        return self._rrt_connect(home, over, np.array(self._settings.home))

    def _stand_off(self, candidate: Candidate) -> Array:
        return candidate.T_base_tcp @ transform(position=(0.0, 0.0, -self._settings.stand_off))

    def _rrt_connect(self, checker: CollisionChecker, start: Array, goal: Array) -> bool:
        """Whether OMPL with its default range, resolution and simplification finds a path within the joint limits."""
        space = ob.RealVectorStateSpace(6)
        bounds = ob.RealVectorBounds(6)
        for k in range(6):
            bounds.setLow(k, float(self._ik.lower[k]))
            bounds.setHigh(k, float(self._ik.upper[k]))
        space.setBounds(bounds)
        setup = og.SimpleSetup(space)
        setup.setStateValidityChecker(lambda state: not checker.in_collision([state[k] for k in range(6)]))
        setup.setPlanner(og.RRTConnect(setup.getSpaceInformation()))
        setup.setStartAndGoalStates(_state(space, start), _state(space, goal))
        deadline = time.thread_time() + TIMEOUT
        solved = setup.solve(ob.PlannerTerminationCondition(lambda: time.thread_time() > deadline))
        if not solved or not setup.haveExactSolutionPath():
            return False
        setup.simplifySolution()
        return True


def _state(space: ob.StateSpace, q: Array) -> ob.State:
    state = space.allocState()
    for k in range(6):
        state[k] = float(q[k])
    return state

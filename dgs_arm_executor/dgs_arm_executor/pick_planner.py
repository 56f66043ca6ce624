"""Chooses grasp and arm motion together: the best-scored candidate whose whole pick, from here to home, is free."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.candidate_check import check_candidate
from dgs_arm_executor.cartesian import CartesianLine, track_line
from dgs_arm_executor.ik import T_TCP_TOOL0, T_TOOL0_TCP, ArmIK, nearest_turn
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.paths import plan_path
from dgs_arm_executor.pick_checkers import PickCheckers
from dgs_arm_executor.pick_types import (
    Candidate,
    Load,
    PickAnswer,
    PickPlan,
    PickSettings,
    Rejection,
)
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene, SceneSettings, Situation
from dgs_arm_executor.release import release_poses, release_states
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Limits, Trajectory, time_path
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_description.joints import ARM_VELOCITY

Array = NDArray[np.float64]

_CENTRE_WEIGHT, _DEXTERITY_WEIGHT = 0.05, 0.02
"""In the cost of a branch, against seconds of way: distance from the joints' middle, nearness to a singularity."""


@dataclass(frozen=True)
class _Motion:
    """The part of a pick that does not depend on where the arm starts: stand-off, grasp, lift."""

    approach: CartesianLine
    lift: CartesianLine

    @property
    def stand_off(self) -> Array:
        return self.approach.joints[0]

    @property
    def grasp(self) -> Array:
        return self.approach.joints[-1]

    @property
    def lifted(self) -> Array:
        return self.lift.joints[-1]


@dataclass
class PickPlanner:
    """Plans whole picks for one cell.

    Attributes:
        ik: of the arm.
        settings: geometry, speeds, time limits.
        scene_settings: clearances.
        limits: of the joints, before the speed factors.
    """

    ik: ArmIK = field(default_factory=ArmIK)
    settings: PickSettings = field(default_factory=PickSettings)
    scene_settings: SceneSettings = field(default_factory=SceneSettings)
    limits: Limits = field(default_factory=Limits)

    def plan(
        self,
        start: ArrayLike,
        hand_joints: ArrayLike,
        candidates: Sequence[Candidate],
        cloud: ObstacleCloud | None = None,
        keep_holding: bool = False,
    ) -> PickAnswer:
        """Plan start, stand-off, grasp, lift, bin and home for the first candidate that allows all of it.

        Args:
            start: (6,) measured arm joints [rad].
            hand_joints: (20,) measured hand joints [rad].
            candidates: in order of preference.
            cloud: observed obstacles.
            keep_holding: stop after the lift.

        Raises:
            DgsError: NO_CANDIDATES; NO_PATH if the arm starts inside itself or the cell.
        """
        began = time.perf_counter()
        if not candidates:
            raise DgsError(ErrorCode.NO_CANDIDATES, "the goal holds no grasps")
        origin, situation = np.asarray(start, float), Situation(np.asarray(hand_joints, float))
        scene = self._scene(cloud or ObstacleCloud(), origin, situation)
        escape = self._escape(scene, origin, situation)
        begin = origin if escape is None else escape.joints[-1]
        rejections: list[Rejection] = []
        for candidate in candidates:
            try:
                if time.perf_counter() - began > self.settings.time_limit:
                    raise DgsError(
                        ErrorCode.NO_PATH,
                        f"not looked at: the planning time of {self.settings.time_limit:g} s is used up",
                    )
                plan = self._plan_candidate(scene, begin, candidate, keep_holding)
            except DgsError as error:
                rejections.append(Rejection(candidate.index, error.code, error.message))
                continue
            if escape is not None:
                first = {"escape": self._time_line(escape, self.settings.lift_speed)}
                plan = replace(plan, trajectories=first | plan.trajectories)
            return PickAnswer(plan, tuple(rejections), time.perf_counter() - began)
        return PickAnswer(None, tuple(rejections), time.perf_counter() - began)

    def plan_home(
        self,
        start: ArrayLike,
        hand_joints: ArrayLike,
        cloud: ObstacleCloud | None = None,
        load: Load | None = None,
    ) -> list[Trajectory]:
        """Trajectories from the measured state to home with the hand as it is and what it holds, None = nothing.

        Raises:
            DgsError: NO_PATH.
        """
        cloud = cloud or ObstacleCloud()
        hand, begin = np.asarray(hand_joints, float), np.asarray(start, float)
        situation = Situation(hand)
        if load is not None and load.box is not None:
            held = load.box.holds(cloud.points, self.ik.forward(begin) @ T_TOOL0_TCP)
            situation = Situation(hand, held, load.box)
        scene = self._scene(cloud, begin, situation)
        escape = self._escape(scene, begin, situation)
        out = [] if escape is None else [self._time_line(escape, self.settings.lift_speed)]
        begin = begin if escape is None else escape.joints[-1]
        path = plan_path(scene.checker(situation), begin, self.home, self.settings.path)
        if path is None:
            raise DgsError(ErrorCode.NO_PATH, "no collision-free path to the home posture was found")
        return [*out, self._time_path(path, self.settings.speed)]

    def plan_lift(self, arm_joints: ArrayLike, plan: PickPlan) -> Trajectory:
        """The lift of a plan from the measured state: closing fingers may have pushed the arm off its grasp pose.

        Straight to where the planned lift ends, so that what follows it fits.

        Raises:
            DgsError: OUT_OF_REACH, IK_FAILED, JOINT_LIMIT.
        """
        q = np.asarray(arm_joints, float)
        T_start, T_end = (
            self.ik.forward(joints) @ T_TOOL0_TCP for joints in (q, plan.trajectories["lift"].positions[-1])
        )
        return self._time_line(track_line(self.ik, T_start, T_end, q), self.settings.lift_speed)

    @property
    def home(self) -> Array:
        """(6,) home posture [rad]."""
        return np.array(self.settings.home)

    # one candidate

    def _plan_candidate(
        self, scene: PlanningScene, start: Array, candidate: Candidate, keep_holding: bool
    ) -> PickPlan:
        candidate = check_candidate(candidate)
        checkers = PickCheckers(scene, candidate)
        free: list[_Motion] = []
        refused: list[DgsError] = []
        # Direct lines first, branch by branch; the sampling planner only when none of them is free.
        for q in self._grasp_states(start, candidate):
            try:
                motion = self._motion(candidate, q, checkers)
            except DgsError as error:
                refused.append(error)
                continue
            free.append(motion)
            trajectories = self._connect(start, motion, checkers, keep_holding, sampled=False)
            if trajectories is not None:
                return PickPlan(
                    candidate, trajectories, motion.stand_off, motion.grasp, Load(checkers.carried, candidate)
                )
        if not free:
            raise max(refused, key=lambda error: _PROGRESS.index(error.code))
        for motion in free[: self.settings.sampled_goals]:
            trajectories = self._connect(start, motion, checkers, keep_holding, sampled=True)
            if trajectories is not None:
                return PickPlan(
                    candidate, trajectories, motion.stand_off, motion.grasp, Load(checkers.carried, candidate)
                )
        raise DgsError(
            ErrorCode.NO_PATH,
            "no collision-free path to the stand-off or from the lift to the bin was found",
        )

    def _grasp_states(self, start: Array, candidate: Candidate) -> list[Array]:
        """Arm joints (6,) at the grasp on every IK branch, turned next to the start, cheapest first."""
        T_grasp = candidate.T_base_tcp
        found = self.ik.branches((T_grasp @ T_TCP_TOOL0)[None], wrist_3=float(start[5]))[0]
        found = found[~np.isnan(found[:, 0])]
        if not len(found):
            raise DgsError(
                ErrorCode.OUT_OF_REACH, f"the grasp at {_place(T_grasp)} is out of the arm's reach"
            )
        states = nearest_turn(found, start, self.ik.lower, self.ik.upper)
        states = states[~np.isnan(states).any(1)]
        if not len(states):
            raise DgsError(
                ErrorCode.JOINT_LIMIT, f"every solution for {_place(T_grasp)} is beyond a joint limit"
            )
        return sorted(states, key=lambda q: self._cost(q, start))

    def _motion(self, candidate: Candidate, q: Array, checkers: PickCheckers) -> _Motion:
        """Approach to and lift from (6,) joints at the grasp, checked for collisions.

        Raises:
            DgsError: OUT_OF_REACH, IK_FAILED, JOINT_LIMIT, COLLISION_STAND_OFF, COLLISION_APPROACH, COLLISION_LIFT.
        """
        T_grasp = candidate.T_base_tcp
        if checkers.lift.in_collision(q):
            what = checkers.lift.describe(q)
            raise DgsError(ErrorCode.COLLISION_APPROACH, f"with the hand closed {what}")
        back = transform(position=(0.0, 0.0, -self.settings.stand_off))
        approach = track_line(self.ik, T_grasp, T_grasp @ back, q).reversed()
        if checkers.transfer.in_collision(approach.joints[0]):
            what = checkers.transfer.describe(approach.joints[0])
            raise DgsError(ErrorCode.COLLISION_STAND_OFF, f"at the stand-off {what}")
        hit = checkers.approach.first_collision(approach.joints)
        if hit is not None:
            raise DgsError(ErrorCode.COLLISION_APPROACH, f"on the approach {checkers.approach.describe(hit)}")
        up = transform(position=(0.0, 0.0, self.settings.lift))
        try:
            lift = track_line(self.ik, T_grasp, up @ T_grasp, q)
        except DgsError as error:
            raise DgsError(error.code, f"on the lift {error.message}") from error
        hit = checkers.lift.first_collision(lift.joints)
        if hit is not None:
            raise DgsError(ErrorCode.COLLISION_LIFT, f"on the lift {checkers.lift.describe(hit)}")
        return _Motion(approach, lift)

    def _cost(self, q: Array, start: Array) -> float:
        """Seconds of way at full speed, plus small terms for joints far from their middle and for low dexterity."""
        way = float((np.abs(q - start) / ARM_VELOCITY).max())
        off_centre = float(((q / self.ik.upper) ** 2).sum())
        return (
            way + _CENTRE_WEIGHT * off_centre + _DEXTERITY_WEIGHT / max(10 * self.ik.manipulability(q), 1e-3)
        )

    def _connect(
        self, start: Array, motion: _Motion, checkers: PickCheckers, keep_holding: bool, sampled: bool
    ) -> dict[str, Trajectory] | None:
        """Trajectories of all stages, or None where the motion cannot be reached or left."""
        transfer = self._path(checkers.transfer, start, motion.stand_off, sampled)
        if transfer is None:
            return None
        out = {
            "transfer": self._time_path(transfer, self.settings.speed),
            "approach": self._time_line(motion.approach, self.settings.approach_speed),
            "lift": self._time_line(motion.lift, self.settings.lift_speed),
        }
        if keep_holding:
            return out
        poses = release_poses(self.settings.cell, checkers.carried, self.settings.release_clearance)
        states = release_states(self.ik, poses, motion.lifted)[: self.settings.release_tries]
        free = (q for q in states if not checkers.carry.in_collision(q) and not checkers.home.in_collision(q))
        for release in islice(free, self.settings.sampled_goals if sampled else None):
            carry = self._path(checkers.carry, motion.lifted, release, sampled)
            home = None if carry is None else self._path(checkers.home, release, self.home, sampled)
            if carry is not None and home is not None:
                out["carry"] = self._time_path(carry, self.settings.carry_speed)
                out["home"] = self._time_path(home, self.settings.speed)
                return out
        return None

    def _path(self, checker: CollisionChecker, start: Array, goal: Array, sampled: bool) -> SmoothPath | None:
        if sampled:
            return plan_path(checker, start, goal, self.settings.path)
        return (
            SmoothPath.line(start, goal) if checker.first_collision(np.stack([start, goal])) is None else None
        )

    def _time_path(self, path: SmoothPath, speed: float) -> Trajectory:
        return time_path(path, self.limits.scaled(speed), self.settings.rate)

    def _time_line(self, line: CartesianLine, speed: float) -> Trajectory:
        return time_path(line.smooth(), self.limits.scaled(self.settings.speed), self.settings.rate, speed)

    # the start

    def _scene(self, cloud: ObstacleCloud, start: Array, situation: Situation) -> PlanningScene:
        """The scene; without a clearance (cell and itself, cloud) that the robot does not keep at the start."""
        settings = self.scene_settings
        scene = PlanningScene(cloud, settings)
        if scene.checker(replace(situation, use_cloud=False, hand_on_table=True)).in_collision(start):
            settings = replace(settings, arm_clearance=0.0)
        near = replace(situation, hand_on_table=True, cloud_clearance=settings.transfer_clearance)
        if scene.checker(near).in_collision(start):
            settings = replace(settings, transfer_clearance=0.0)
        return scene if settings is self.scene_settings else PlanningScene(cloud, settings)

    def _escape(self, scene: PlanningScene, start: Array, situation: Situation) -> CartesianLine | None:
        """A short straight way out of the observed cloud, or None where the arm is not in it.

        After a stop in the middle of a grasp the fingers are around the object, and what the hand holds may still
        stand on the table, so every path would start in collision.
        """
        whole = scene.checker(situation)
        if not whole.in_collision(start):
            return None
        without_cloud = scene.checker(replace(situation, use_cloud=False, hand_on_table=True))
        if without_cloud.in_collision(start):
            raise DgsError(
                ErrorCode.NO_PATH,
                f"the arm starts in collision ({without_cloud.describe(start)}): move it free by hand first",
            )
        T_start = self.ik.forward(start) @ T_TOOL0_TCP
        back = transform(position=(0.0, 0.0, -self.settings.stand_off))
        up = transform(position=(0.0, 0.0, self.settings.lift))
        ways = (T_start @ back, up @ T_start, up @ T_start @ back)
        for T_end in ways if situation.carried is None else ways[1:]:
            try:
                line = track_line(self.ik, T_start, T_end, start)
            except DgsError:
                continue
            if without_cloud.first_collision(line.joints) is None and not whole.in_collision(line.joints[-1]):
                return line
        raise DgsError(
            ErrorCode.NO_PATH,
            f"the arm starts inside the observed cloud ({whole.describe(start)}) and no straight way out is free",
        )


_PROGRESS = (
    ErrorCode.OUT_OF_REACH,
    ErrorCode.JOINT_LIMIT,
    ErrorCode.IK_FAILED,
    ErrorCode.COLLISION_STAND_OFF,
    ErrorCode.COLLISION_APPROACH,
    ErrorCode.COLLISION_LIFT,
    ErrorCode.NO_PATH,
)
"""Reasons in the order in which a pick meets them: of several branches the one that came farthest is reported."""


def _place(T_base_tcp: Array) -> str:
    x, y, z = T_base_tcp[:3, 3]
    return f"({x:.3f}, {y:.3f}, {z:.3f}) m"

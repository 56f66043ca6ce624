"""Drives a planned pick stage by stage, and brings arm and hand to a defined end when a stage fails."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.grasp_state import HoldSettings, fingers_held_off, names, object_held
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.pick_types import OPEN_HAND, Candidate, PickPlan, Rejection
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode

Array = NDArray[np.float64]

HOLD_CODES = frozenset({ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP})
"""After these nothing moves any more, the hand included, until a reset."""


class Robot(Protocol):
    """What the sequence needs of arm and hand. Every method raises DgsError when it is interrupted."""

    def arm_joints(self) -> Array:
        """(6,) measured just now [rad]."""

    def hand_joints(self) -> Array:
        """(20,) measured just now [rad]."""

    def observed_cloud(self, arm_joints: Array, hand_joints: Array) -> ObstacleCloud:
        """The newest cloud, without the robot."""

    def move_arm(self, trajectory: Trajectory, hand_joints: Array) -> None:
        """Follow a trajectory to its end, the hand being in the given shape."""

    def move_hand(
        self, joints: Array, mode: Literal["position", "grasp"], uninterrupted: bool = False
    ) -> None:
        """Bring the hand to (20,) joints, or close it towards them; `uninterrupted`: also after a cancel."""

    def enter(self, stage: str, candidate: int) -> None:
        """Say which stage begins."""


@dataclass
class PickReport:
    """How a pick ended."""

    code: ErrorCode = ErrorCode.SUCCESS
    message: str = ""
    executed_index: int = -1
    object_held: bool = False
    rejections: tuple[Rejection, ...] = ()
    stage_times: dict[str, float] = field(default_factory=dict)


class PickExecution:
    """One pick from the goal to its report."""

    def __init__(self, robot: Robot, planner: PickPlanner, hold: HoldSettings | None = None):
        self._robot, self._planner, self._hold = robot, planner, hold or HoldSettings()
        self._carrying = False
        self._hand_disturbed = False
        self._cloud = ObstacleCloud()
        self.report = PickReport()

    def run(self, candidates: Sequence[Candidate], plan_only: bool, keep_holding: bool) -> PickReport:
        """Plan and execute; never raises DgsError, the report carries it."""
        report = self.report
        try:
            plan = self._plan(candidates, keep_holding)
            report.executed_index = plan.candidate.index
            if plan_only:
                number, seconds = plan.candidate.index, plan.duration
                report.message = f"grasp {number} can be executed in {seconds:.1f} s; nothing was moved"
                return report
            self._execute(plan, keep_holding)
        except DgsError as error:
            report.code, report.message = error.code, error.message
            self._end_safely(error.code)
        return report

    def _plan(self, candidates: Sequence[Candidate], keep_holding: bool) -> PickPlan:
        with self._stage("planning"):
            arm, hand = self._robot.arm_joints(), self._robot.hand_joints()
            self._cloud = self._robot.observed_cloud(arm, hand)
            answer = self._planner.plan(arm, hand, candidates, self._cloud, keep_holding)
        self.report.rejections = answer.rejections
        if answer.plan is None:
            raise DgsError(ErrorCode.NO_FEASIBLE_GRASP, _nothing_feasible(answer.rejections))
        return answer.plan

    def _execute(self, plan: PickPlan, keep_holding: bool) -> None:
        candidate, robot = plan.candidate, self._robot
        target = self._cloud.target_mask(candidate.reference_point, candidate.T_base_tcp[:3, 3])
        self._cloud = self._cloud.without(target)
        pre, closed = candidate.pre_grasp_joints, candidate.grasp_joints
        if "escape" in plan.trajectories:
            self._drive(plan, "escape", robot.hand_joints())
        with self._stage("pre_grasp"):
            self._hand_disturbed = True
            robot.move_hand(pre, "position")
        self._drive(plan, "transfer", pre)
        self._drive(plan, "approach", pre)
        with self._stage("close"):
            robot.move_hand(closed, "grasp")
        self._carrying = True
        with self._stage("lift"):
            robot.move_arm(self._planner.plan_lift(robot.arm_joints(), plan), closed)
        held = self._held(candidate)
        self.report.object_held = bool(held)
        if not held:
            self._carrying = False
            self._give_up(ErrorCode.NOTHING_HELD, "the hand closed but holds nothing after the lift")
        if keep_holding:
            self.report.message = f"grasp {candidate.index} holds the object above the table"
            return
        self._drive(plan, "carry", closed)
        if not self._held(candidate):
            self._carrying = False
            self._give_up(ErrorCode.LOST_OBJECT, "the object was lost on the way to the bin")
        with self._stage("release"):
            self._let_go(pre)
            self._carrying = False
        self._drive(plan, "home", OPEN_HAND)
        self.report.message = f"grasp {candidate.index} lifted the object and released it over the bin"

    def _let_go(self, pre_grasp: Array) -> None:
        """Open over the bin; where something jams a finger, back to the pre-grasp's yaw first and once more."""
        try:
            self._robot.move_hand(OPEN_HAND, "position")
        except DgsError as error:
            if error.code is not ErrorCode.HAND_BLOCKED:
                raise
            self._robot.move_hand(pre_grasp, "position")
            self._robot.move_hand(OPEN_HAND, "position")

    def _drive(self, plan: PickPlan, stage: str, hand_joints: Array) -> None:
        with self._stage(stage):
            self._robot.move_arm(plan.trajectories[stage], hand_joints)

    def _held(self, candidate: Candidate) -> bool:
        joints = (self._robot.hand_joints(), candidate.pre_grasp_joints, candidate.grasp_joints, self._hold)
        self.report.message = f"held off: {names(fingers_held_off(*joints))}"
        return object_held(*joints)

    def _give_up(self, code: ErrorCode, message: str) -> None:
        """Open the hand, go home, and end with a code."""
        detail, self.report.object_held = self.report.message, False
        with self._stage("release"):
            self._robot.move_hand(OPEN_HAND, "position")
        with self._stage("home"):
            for trajectory in self._planner.plan_home(self._robot.arm_joints(), OPEN_HAND, self._cloud):
                self._robot.move_arm(trajectory, OPEN_HAND)
        raise DgsError(code, f"{message} ({detail}); the hand is open and the arm at home")

    def _end_safely(self, code: ErrorCode) -> None:
        """The arm holds (whoever raised has seen to that); the hand opens unless it carries or must not move."""
        if code in (ErrorCode.NOTHING_HELD, ErrorCode.LOST_OBJECT):
            return
        if code in HOLD_CODES:
            self.report.message += "; arm and hand hold where they are until /reset"
        elif self._carrying:
            self.report.message += "; the arm holds and the hand keeps holding"
        elif self._hand_disturbed:
            try:
                self._robot.move_hand(OPEN_HAND, "position", uninterrupted=True)
                self.report.message += "; the arm holds and the hand is open"
            except DgsError as error:
                self.report.message += f"; the arm holds, but the hand could not be opened: {error.message}"

    @contextmanager
    def _stage(self, stage: str) -> Iterator[None]:
        began = time.perf_counter()
        self._robot.enter(stage, self.report.executed_index)
        try:
            yield
        except DgsError as error:
            raise type(error)(error.code, f"{stage}: {error.message}") from error
        finally:
            times = self.report.stage_times
            times[stage] = times.get(stage, 0.0) + time.perf_counter() - began


def _nothing_feasible(rejections: Sequence[Rejection]) -> str:
    counts: dict[str, int] = {}
    for rejection in rejections:
        counts[rejection.code.name] = counts.get(rejection.code.name, 0) + 1
    reasons = ", ".join(
        f"{count} {name}" for name, count in sorted(counts.items(), key=lambda item: -item[1])
    )
    return f"none of {len(rejections)} grasps can be executed: {reasons}"

"""Drives a planned pick stage by stage, and brings arm and hand to a defined end when a stage fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.grasp_state import HoldSettings, fingers_held_off, names, object_held
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.pick_types import OPEN_HAND, Candidate, Load, PickPlan, Rejection
from dgs_arm_executor.stages import HOLD_CODES, Robot, Stages, has_let_go, is_hand_fault, open_hand
from dgs_description.errors import DgsError, ErrorCode

Array = NDArray[np.float64]


@dataclass
class PickReport:
    """How a pick ended."""

    code: ErrorCode = ErrorCode.SUCCESS
    message: str = ""
    executed_index: int = -1
    object_held: bool = False
    object_released: bool = False
    rejections: tuple[Rejection, ...] = ()
    stage_times: dict[str, float] = field(default_factory=dict)


class PickExecution:
    """One pick from the goal to its report.

    Attributes:
        load: what the hand holds at the end, None = nothing.
        report: what came of it.
    """

    def __init__(
        self, robot: Robot, planner: PickPlanner, hold: HoldSettings | None = None, load: Load | None = None
    ):
        """`load`: what the hand still holds of an earlier goal."""
        self._robot, self._planner, self._hold = robot, planner, hold or HoldSettings()
        self._stage = Stages(robot)
        self.load = load
        self._hand_disturbed = False
        self._at_home = False
        self._cloud = ObstacleCloud()
        self.report = PickReport(stage_times=self._stage.times)

    def run(self, candidates: Sequence[Candidate], plan_only: bool, keep_holding: bool) -> PickReport:
        """Plan and execute; never raises DgsError, the report carries it."""
        report = self.report
        try:
            plan = self._plan(candidates, keep_holding)
            report.executed_index = self._stage.candidate = plan.candidate.index
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
            self._cloud = self._robot.observed_cloud(arm, hand, fresh=True)
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
            self._hand_disturbed, self.load = True, None
            robot.set_payload(holding=False)
            robot.move_hand(pre, "position")
        self._drive(plan, "transfer", pre)
        self._drive(plan, "approach", pre)
        with self._stage("close"):
            robot.move_hand(closed, "grasp")
        self.load = plan.load
        with self._stage("lift"):
            robot.move_arm(self._planner.plan_lift(robot.arm_joints(), plan), closed)
        held = self._held(candidate)
        self.report.object_held = held
        if not held:
            self._give_up(ErrorCode.NOTHING_HELD, "the hand closed but holds nothing after the lift")
        if keep_holding:
            robot.set_payload(holding=True)
            self.report.message = f"grasp {candidate.index} holds the object above the table"
            return
        with self._stage("carry"):
            robot.set_payload(holding=True)
            robot.move_arm(plan.trajectories["carry"], closed)
        if not self._held(candidate):
            self._give_up(ErrorCode.LOST_OBJECT, "the object was lost on the way to the bin")
        with self._stage("release"):
            trouble = self._release(pre)
            robot.set_payload(holding=False)
        if trouble is None:
            self._drive(plan, "home", OPEN_HAND)
            self.report.message = f"grasp {candidate.index} lifted the object and released it over the bin"
        else:
            self._go_home()
            raise DgsError(
                trouble.code,
                f"the object was released over the bin, but the hand has a fault: {trouble.message}",
            )

    def _release(self, pre_grasp: Array) -> DgsError | None:
        """Open over the bin; what ends that may come before or after the fingers have let go.

        Args:
            pre_grasp: (20,) [rad].

        Returns:
            The hand's fault if it could not open wholly and yet has let go.

        Raises:
            DgsError: who interrupted it, or the hand's fault and it may still hold the object.
        """
        before, trouble = self._robot.hand_reading(), None
        try:
            self._open_over_the_bin(pre_grasp)
        except DgsError as error:
            trouble = error
        released = trouble is None or has_let_go(self._robot, before, trouble, self._hold)
        if released:
            self.load, self.report.object_released = None, True
        if trouble is None or (released and is_hand_fault(trouble)):
            return trouble
        if is_hand_fault(trouble):
            raise DgsError(trouble.code, f"the hand could not let go of the object: {trouble.message}")
        raise trouble

    def _open_over_the_bin(self, pre_grasp: Array) -> None:
        """Open wholly; where something jams a finger, back to the pre-grasp's yaw first and once more."""
        trouble = open_hand(self._robot)
        if trouble is not None and trouble.code is ErrorCode.HAND_BLOCKED:
            self._robot.move_hand(pre_grasp, "position", uninterrupted=True)
            trouble = open_hand(self._robot)
        if trouble is not None:
            raise trouble

    def _drive(self, plan: PickPlan, stage: str, hand_joints: Array) -> None:
        with self._stage(stage):
            self._robot.move_arm(plan.trajectories[stage], hand_joints)

    def _held(self, candidate: Candidate) -> bool:
        joints = (self._robot.hand_joints(), candidate.pre_grasp_joints, candidate.grasp_joints, self._hold)
        self.report.message = f"held off: {names(fingers_held_off(*joints))}"
        return bool(object_held(*joints))

    def _give_up(self, code: ErrorCode, message: str) -> None:
        """Open the hand, go home, and end with a code."""
        detail, self.report.object_held = self.report.message, False
        self.load = None
        with self._stage("release"):
            trouble = open_hand(self._robot)
            self._robot.set_payload(holding=False)
        self._go_home()
        hand = "the hand is open" if trouble is None else f"the hand has a fault: {trouble.message}"
        raise DgsError(code, f"{message} ({detail}); {hand} and the arm at home")

    def _go_home(self) -> None:
        """From the measured state, the hand as it is."""
        with self._stage("home"):
            hand = self._robot.hand_joints()
            for trajectory in self._planner.plan_home(self._robot.arm_joints(), hand, self._cloud):
                self._robot.move_arm(trajectory, hand)
        self._at_home = True

    def _end_safely(self, code: ErrorCode) -> None:
        """The arm holds (whoever raised has seen to that); the hand opens unless it carries or must not move."""
        if self._at_home:
            return
        if code in HOLD_CODES:
            self.report.message += "; arm and hand hold where they are until /reset"
        elif self.load is not None:
            self.report.message += "; the arm holds and the hand keeps holding"
        elif self._hand_disturbed:
            try:
                self._robot.move_hand(OPEN_HAND, "position", uninterrupted=True)
                self.report.message += "; the arm holds and the hand is open"
            except DgsError as error:
                self.report.message += f"; the arm holds, but the hand could not be opened: {error.message}"


def _nothing_feasible(rejections: Sequence[Rejection]) -> str:
    counts: dict[str, int] = {}
    for rejection in rejections:
        counts[rejection.code.name] = counts.get(rejection.code.name, 0) + 1
    reasons = ", ".join(
        f"{count} {name}" for name, count in sorted(counts.items(), key=lambda item: -item[1])
    )
    return f"none of {len(rejections)} grasps can be executed: {reasons}"

"""Drives a planned pick or the way home stage by stage, and brings arm and hand to a defined end when a stage fails."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from dgs_arm_executor.grasp_state import (
    HoldSettings,
    fingers_held_off,
    grip_lost,
    is_open,
    names,
    object_held,
)
from dgs_arm_executor.letting_go import let_go, loosen
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_plan import PickAnswer, PickPlan, Prepared, Rejection, Wish
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.robot import Robot, is_hand_fault
from dgs_arm_executor.situation import ArmSituation, Load
from dgs_arm_executor.stages import Stages
from dgs_arm_executor.timing import Trajectory
from dgs_arm_executor.view import time_out_of_view
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

_HOLD_CODES = (ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP)
"""After these nothing moves any more, the hand included, until a reset."""
_OBSTRUCTED = (ErrorCode.HAND_BLOCKED, ErrorCode.HAND_TIMEOUT)
"""Codes of an empty hand that something keeps from a shape."""
_CLOSE_ENOUGH = 0.02
"""A hand that meets something when only so much of its approach is left goes on from there [m], ..."""
_RELIEF, _STEP, _STEPS = 0.004, 0.0005, 16
"""... so much higher [m]; if it pushes, after so many such steps at most, until it presses with half the bound."""
_AT_HOME = 0.02
"""An arm this close to its home posture is there [rad]."""


@dataclass
class Report:
    """How a pick or the way home ended."""

    code: ErrorCode = ErrorCode.SUCCESS
    message: str = ""
    executed_index: int = -1
    object_held: bool = False
    object_released: bool = False
    rejections: tuple[Rejection, ...] = ()
    stage_times: dict[str, float] = field(default_factory=dict)


class Execution:
    """One goal from its beginning to its report. Its methods never raise DgsError: the report carries it."""

    def __init__(
        self,
        robot: Robot,
        planner: PickPlanner,
        hold: HoldSettings,
        offer: Callable[[ArmSituation], None] = lambda _: None,
        tell: Callable[[PickAnswer], None] = lambda _: None,
    ):
        """Take what a goal works with.

        Args:
            hold: when the hand counts as holding something.
            offer: told how a pick that another one is to follow will leave the robot, once it is on its last way.
            tell: called with what was planned for a pick.
        """
        self._robot, self._planner, self._hold, self._offer, self._tell = robot, planner, hold, offer, tell
        self._stages = Stages(robot, planner)
        self._disturbed: GraspSet | None = None  # the grasp that the hand has left its open shape for
        self._met = False  # the hand has come down on something near the grasp
        self.report = Report(stage_times=self._stages.times)

    def pick(self, grasps: GraspSet, wish: Wish) -> Report:
        """Plan and execute the best grasp that the arm can reach; leave hand and arm in a defined state."""
        return self._execute(lambda: self._plan(grasps, wish), wish)

    def pick_prepared(self, prepared: Prepared, wish: Wish) -> Report:
        """As `pick`, of what was planned while the goal before carried its object away."""
        return self._execute(lambda: self._take_up(prepared), wish)

    def go_home(self) -> Report:
        """Bring the arm home from wherever a fault has left it.

        What the hand still holds goes into the bin first, and what hangs on its fingers is shaken off there.
        """
        report, robot = self.report, self._robot
        try:
            off = np.abs(robot.watch.arm_joints() - self._planner.home).max()
            if off < _AT_HOME and robot.load is None and not robot.obstructed:
                report.message = "the arm was at home already"
                return report
            load, room, trouble = robot.load, True, None
            if load is not None and not is_open(robot.situation().hand_joints):
                self._empty_into_the_bin(load)
            else:
                robot.load = None
                with self._stages("release"):
                    robot.set_payload(holding=False)
                    situation = robot.situation()
                    opened = self._planner.opened(situation, otherwise=situation.hand_joints)
                    trouble = robot.open_hand(opened)  # a jammed hand must not keep the arm over the table
                    room = np.array_equal(opened, HAND.open_hand)
            if robot.obstructed:
                self._shake_off()
            self._stages.drive_home(look=True)
            if not room:
                trouble = robot.open_hand()
            also = " and the object in the bin" if report.object_released else ""
            also += "" if trouble is None else f", but the hand has a fault: {trouble.message}"
            report.message = f"the arm is at home{also}"
        except DgsError as error:
            end = "until /reset" if error.code in _HOLD_CODES else "where it is"
            report.code, report.message = error.code, f"{error.message}; the arm holds {end}"
        return report

    # a pick

    def _execute(self, choose: Callable[[], PickPlan], wish: Wish) -> Report:
        report = self.report
        try:
            plan = choose()
            report.executed_index = self._robot.candidate = plan.index
            if wish.plan_only:
                possible = f"grasp {plan.index} can be executed in {plan.duration:.1f} s"
                report.message = f"{possible}; nothing was moved"
            else:
                self._reach(plan)
                if plan.grasp.holds:
                    self._grip(plan)
                    self._deliver(plan, wish)
                else:
                    self._leave(plan, wish)
        except DgsError as error:
            report.code, report.message = error.code, error.message
            self._end_safely(error.code)
        return report

    def _plan(self, grasps: GraspSet, wish: Wish) -> PickPlan:
        with self._stages("planning"):
            answer = self._planner.plan(self._robot.look(fresh=True), grasps, wish.keep_holding)
        self.report.rejections = answer.rejections
        self._tell(answer)
        return answer.chosen()

    def _take_up(self, prepared: Prepared) -> PickPlan:
        """The prepared plan, if the table is still as it was when it was made."""
        self.report.rejections = prepared.answer.rejections
        self.report.stage_times["planning"] = prepared.seconds
        plan = prepared.answer.chosen()
        with self._stages("look_again"):
            difference = self._robot.look(fresh=True).cloud.difference(prepared.cloud, plan.grasp)
            if difference:
                raise DgsError(
                    ErrorCode.SCENE_CHANGED, f"{difference}; nothing was moved: look at the table again"
                )
        return plan

    def _reach(self, plan: PickPlan) -> None:
        """From the start to the grasp, through its motion."""
        robot, grasp = self._robot, plan.grasp
        robot.cloud = robot.cloud.without(robot.cloud.carried_mask(grasp))
        if "escape" in plan.trajectories:
            self._stages.drive(plan, "escape", robot.situation().hand_joints)
        shaping = plan.shaping_on_the_way and robot.load is None  # an opening hand would fling what it holds
        with self._stages("transfer" if shaping else "pre_grasp"):
            robot.set_payload(holding=False)
            self._disturbed, robot.load, robot.obstructed = grasp, None, False
            self._shape(grasp.pre_grasp_joints, plan.trajectories["transfer"] if shaping else None)
        if not shaping:
            self._stages.drive(plan, "transfer", grasp.pre_grasp_joints)
        robot.watch.force.tare()
        self._met = self._approach(plan)
        shape = grasp.pre_grasp_joints
        if grasp.drags:
            self._close(grasp)
            robot.watch.force.forget()  # fingers that close may press for a moment
            shape = grasp.grasp_joints
        if self._met and not grasp.holds:  # as high as it is now, or it would press again
            with self._stages("advance"):
                on = self._planner.plan_shift(robot.watch.arm_joints(), grasp.motion, pushing=True)
                self._stages.move(on, "advance", shape)
        elif grasp.drags:
            self._stages.drive_off(plan, "advance", shape)
        elif "advance" in plan.trajectories:
            self._stages.drive(plan, "advance", shape)

    def _approach(self, plan: PickPlan) -> bool:
        """To the grasp, or near it to what the hand has met there; whether it has met something."""
        shape = plan.grasp.pre_grasp_joints
        try:
            self._stages.drive(plan, "approach", shape)
        except DgsError as error:
            slides = plan.grasp.holds and "advance" in plan.trajectories
            if error.code is not ErrorCode.FORCE_LIMIT or slides or self._far_from(plan):
                raise
            try:
                self._stages.ease_off([_STEP] * _STEPS if not plan.grasp.active_fingers.any() else [_RELIEF])
            except DgsError as trouble:  # then it is to back off from what it presses on
                if trouble.code in _HOLD_CODES:
                    raise
                raise DgsError(error.code, f"{error.message}; {trouble.message}") from trouble
            return True
        return False

    def _far_from(self, plan: PickPlan) -> bool:
        here, there = self._robot.watch.arm_joints(), plan.trajectories["approach"].end
        return self._planner.distance(here, there) > _CLOSE_ENOUGH

    def _leave(self, plan: PickPlan, wish: Wish) -> None:
        """Back, or with an open hand, up and home from where a push or a drag has ended."""
        home, shape = plan.trajectories["home"], plan.grasp.pre_grasp_joints
        if plan.grasp.drags:
            with self._stages("release"):
                self._shape(shape)
        elif not self._met:
            self._retreat(plan, shape)
        self._stages.drive_off(plan, "lift", shape)
        clear = self._clear_from(home, shape, shape) if wish.stay_over_bin else np.inf
        with self._stages("home"):
            self._robot.move_arm(home, shape, clear_from=clear)
        way = 1e3 * float(np.linalg.norm(plan.grasp.motion))
        done = "dragged" if plan.grasp.drags else "pushed"
        self.report.message = f"grasp {plan.index} {done} over {way:.0f} mm"

    def _retreat(self, plan: PickPlan, shape: Array) -> None:
        """Back from what was pushed; fingers that press on it leave it upwards."""
        try:
            self._stages.drive_off(plan, "retreat", shape)
        except DgsError as error:
            if error.code is not ErrorCode.FORCE_LIMIT:
                raise

    def _shape(self, hand_joints: Array, transfer: Trajectory | None = None) -> None:
        """Bring the hand into a shape, on the way if there is one; if it does not get there something hangs on it."""
        robot = self._robot
        try:
            if transfer is None:
                robot.move_hand(hand_joints)
            else:
                robot.move_both(transfer, hand_joints)
        except DgsError as error:
            robot.obstructed = error.code in _OBSTRUCTED
            raise

    def _close(self, grasp: GraspSet) -> None:
        with self._stages("close"):
            self._robot.move_hand(grasp.grasp_joints, closing=grasp.active_fingers)

    def _grip(self, plan: PickPlan) -> None:
        """From the grasp to the lifted object, or raise NOTHING_HELD."""
        robot, grasp = self._robot, plan.grasp
        self._close(grasp)
        self._closed = robot.situation()
        robot.load = plan.load
        self._stages.drive_off(plan, "lift", grasp.grasp_joints)
        self.report.object_held = self._held(grasp)
        if not self.report.object_held:
            self._give_up(grasp, ErrorCode.NOTHING_HELD, "the hand closed but holds nothing after the lift")

    def _deliver(self, plan: PickPlan, wish: Wish) -> None:
        """From the lifted object to the bin, and home unless the arm is to stay there."""
        robot, grasp = self._robot, plan.grasp
        if wish.keep_holding:
            robot.set_payload(holding=True)
            self.report.message = f"grasp {plan.index} holds the object above the table"
            return
        carry, clear = plan.trajectories["carry"], np.inf
        if wish.stay_over_bin:
            clear = self._clear_from(carry, grasp.grasp_joints, HAND.open_hand, plan.load.box)
        with self._stages("carry"):
            robot.set_payload(holding=True)
            robot.move_arm(carry, grasp.grasp_joints, clear_from=clear)
        if not self._held(grasp):
            self._give_up(grasp, ErrorCode.LOST_OBJECT, "the object was lost on the way to the bin")
        with self._stages("release"):
            trouble = self._release(grasp)
        if trouble is not None:
            self._stages.drive_home()
            released = "the object was released over the bin"
            raise DgsError(trouble.code, f"{released}, but the hand has a fault: {trouble.message}")
        self.report.message = f"grasp {plan.index} lifted the object and released it over the bin"
        if not wish.stay_over_bin:
            self._stages.drive(plan, "home", HAND.open_hand)

    def _clear_from(
        self, way: Trajectory, hand_joints: Array, left: Array, carried: CarriedBox | None = None
    ) -> float:
        """As `time_out_of_view` of the last way, whose end is offered to the next goal.

        Before its stage is told: who hears of that may send the goal at once.
        """
        self._offer(ArmSituation(way.end, left))
        return time_out_of_view(way, hand_joints, left, carried)

    def _give_up(self, grasp: GraspSet, code: ErrorCode, message: str) -> None:
        """Open the hand, go home, and end with a code."""
        situation = self._robot.situation()
        held = fingers_held_off(situation.hand_joints, grasp, self._hold)
        self.report.object_held, self._robot.load = False, None
        with self._stages("release"):
            trouble = self._robot.open_hand(self._planner.opened(situation, grasp.pre_grasp_joints))
            if code is ErrorCode.LOST_OBJECT and held.any():  # over the bin, and it may hang on a finger
                loosen(self._robot)
            self._robot.set_payload(holding=False)
        self._stages.drive_home()
        hand = "the hand is open" if trouble is None else f"the hand has a fault: {trouble.message}"
        raise DgsError(code, f"{message} (held off: {names(held)}); {hand} and the arm at home")

    def _end_safely(self, code: ErrorCode) -> None:
        """The arm holds (whoever raised has seen to that); the hand opens unless it carries or must not move."""
        if self._stages.at_home:
            return
        if code in _HOLD_CODES:
            until = " until /reset" if self._robot.watch.latched else ""  # which may have come already
            self.report.message += f"; arm and hand hold where they are{until}"
        elif self._robot.load is not None:
            self.report.message += "; the arm holds and the hand keeps holding"
        elif self._disturbed is not None:
            self._open_where_it_stands(self._disturbed, code)

    def _open_where_it_stands(self, grasp: GraspSet, code: ErrorCode) -> None:
        """Open the empty hand; first it rises where it presses on something, or would, if it opened there."""
        opened, end = grasp.pre_grasp_joints, "the arm holds"
        pressed = code is ErrorCode.FORCE_LIMIT
        if grasp.drags and pressed:
            with suppress(DgsError):  # what it drags is to stay on the table
                self._robot.move_hand(opened, uninterrupted=True)
        # A hand that is jammed after a drag presses on the table the more, the wider it is told to open.
        if pressed or (grasp.drags and code is ErrorCode.HAND_BLOCKED):
            try:
                self._stages.back_off(self._planner.settings.lift)
            except DgsError as error:
                if error.code in _HOLD_CODES:
                    self.report.code, self.report.message = error.code, error.message
                    return self._end_safely(error.code)
                end = f"the arm holds, but could not back off ({error.message})"
        # Of a drag the hand stands at the table, which an open one would press on.
        if not grasp.drags:
            with suppress(DgsError):  # where a silent arm stands nobody knows
                opened = self._planner.opened(self._robot.situation(), opened)
        try:
            self._robot.move_hand(opened, uninterrupted=True)
            self.report.message += f"; {end} and the hand is open"
        except DgsError as error:
            self.report.message += f"; {end}, but the hand could not be opened: {error.message}"

    def _held(self, grasp: GraspSet) -> bool:
        now = self._robot.situation()
        return object_held(now.hand_joints, grasp, self._hold) and not grip_lost(self._closed, now)

    def _shake_off(self) -> None:
        """Free the fingers over the bin of what hangs on them; where there is no way, it hangs on."""
        robot = self._robot
        robot.obstructed = False
        with self._stages("carry"):
            situation = robot.look(fresh=False)
            try:
                self._stages.follow(self._planner.plan_to_bin(situation), situation)
            except DgsError as error:
                if error.code is not ErrorCode.NO_PATH:
                    raise
                return
        with self._stages("release"):
            loosen(robot)

    def _empty_into_the_bin(self, load: Load) -> None:
        with self._stages("carry"):
            self._robot.set_payload(holding=True)
            situation = self._robot.look(fresh=False)
            self._stages.follow(self._planner.plan_to_bin(situation), situation)
        with self._stages("release"):
            trouble = self._release(load.grasp)
            if trouble is not None:
                raise trouble

    def _release(self, grasp: GraspSet) -> DgsError | None:
        """Open over the bin. It counts as released only if the hand still held it there.

        Returns:
            The hand's fault if it could not open wholly and yet has let go.

        Raises:
            DgsError: who interrupted it, or the hand's fault and it may still hold the object.
        """
        before = self._robot.situation()
        trouble, free = let_go(self._robot, grasp)
        if free:
            self._robot.load = None
            self.report.object_released = object_held(before.hand_joints, grasp, self._hold)
        if trouble is not None and not is_hand_fault(trouble):
            raise trouble
        if trouble is not None and not free:
            raise DgsError(trouble.code, f"the hand could not let go of the object: {trouble.message}")
        self._robot.set_payload(holding=False)
        return trouble

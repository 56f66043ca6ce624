"""Brings the arm home from wherever a fault has left it; what the hand still holds goes into the bin first."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.grasp_state import HoldSettings, object_held
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.pick_types import Load
from dgs_arm_executor.release import release_poses, release_states
from dgs_arm_executor.stages import HOLD_CODES, Robot, Stages, has_let_go, open_hand
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode

Array = NDArray[np.float64]

_AT_HOME = 0.02
"""An arm this close to its home posture is there [rad]."""
_RELEASE_TRIES = 6


@dataclass
class HomeReport:
    """How the way home ended."""

    code: ErrorCode = ErrorCode.SUCCESS
    message: str = ""
    object_released: bool = False


class Homing:
    """One way home. It says that an object was released only if the hand still held it over the bin.

    Attributes:
        load: what the hand holds, None = nothing; changes when it lets go.
        report: what came of it.
    """

    def __init__(
        self, robot: Robot, planner: PickPlanner, load: Load | None, hold: HoldSettings | None = None
    ):
        self._robot, self._planner, self.load, self._hold = robot, planner, load, hold
        self._stage = Stages(robot)
        self.report = HomeReport()

    def run(self) -> HomeReport:
        """Plan and move; never raises DgsError, the report carries it."""
        report = self.report
        try:
            report.message = self._go()
        except DgsError as error:
            report.code = error.code
            end = "until /reset" if error.code in HOLD_CODES else "where it is"
            report.message = f"{error.message}; the arm holds {end}"
        return report

    def _go(self) -> str:
        robot = self._robot
        at_home = bool(np.abs(robot.arm_joints() - self._planner.home).max() < _AT_HOME)
        if at_home and self.load is None:
            return "the arm was at home already"
        if self.load is not None:
            self._empty_into_the_bin()
        else:
            with self._stage("release"):
                robot.set_payload(holding=False)
                open_hand(robot)  # a jammed hand must not keep the arm over the table
        with self._stage("home"):
            self._follow(self._planner)
        return "the arm is at home" + (" and the object in the bin" if self.report.object_released else "")

    def _empty_into_the_bin(self) -> None:
        robot = self._robot
        with self._stage("carry"):
            robot.set_payload(holding=True)
            for trajectory in self._way_to_the_bin():
                robot.move_arm(trajectory, robot.hand_joints())
        with self._stage("release"):
            arrived, before = self._still_held(), robot.hand_reading()
            try:
                trouble = open_hand(robot)
                if trouble is not None:
                    raise trouble
            except DgsError as error:
                if has_let_go(robot, before, error, self._hold):
                    self.load, self.report.object_released = None, arrived
                raise
            self.load, self.report.object_released = None, arrived
            robot.set_payload(holding=False)

    def _still_held(self) -> bool:
        """Whether the object has not been lost since it was gripped."""
        if self.load is None or self.load.grasp is None:
            return True
        grasp = self.load.grasp
        return object_held(self._robot.hand_joints(), grasp.pre_grasp_joints, grasp.grasp_joints, self._hold)

    def _way_to_the_bin(self) -> list[Trajectory]:
        """Trajectories to the first release posture that can be reached. Raises DgsError NO_PATH."""
        planner, settings = self._planner, self._planner.settings
        start, hand, cloud = self._observe()
        poses = release_poses(
            settings.cell, None if self.load is None else self.load.box, settings.release_clearance
        )
        last = DgsError(ErrorCode.NO_PATH, "no posture over the bin is within reach")
        for posture in release_states(planner.ik, poses, start)[:_RELEASE_TRIES]:
            to_bin = replace(
                planner, settings=replace(settings, home=tuple(posture.tolist()), speed=settings.carry_speed)
            )
            try:
                return to_bin.plan_home(start, hand, cloud, self.load)
            except DgsError as error:
                last = error
        raise last

    def _follow(self, planner: PickPlanner) -> None:
        start, hand, cloud = self._observe()
        for trajectory in planner.plan_home(start, hand, cloud):
            self._robot.move_arm(trajectory, hand)

    def _observe(self) -> tuple[Array, Array, ObstacleCloud]:
        arm, hand = self._robot.arm_joints(), self._robot.hand_joints()
        return arm, hand, self._robot.observed_cloud(arm, hand, fresh=False)

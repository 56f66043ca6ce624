"""The arm's motions of one goal, stage by stage: told, timed, and named in their errors."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.situation import ArmSituation
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.stage_clock import StageClock

_SETTLING = 1.5
"""A way that begins where the arm stands is planned again for so long [s]: what a cloud shows may fall, an arm that was
stopped may brake."""
_UNSETTLED = (ErrorCode.NO_PATH, ErrorCode.SAFETY_ENVELOPE)
"""Codes of a trajectory that was not sent: a moment later it may be free, and begin where the arm stands."""
_BOUNDED = ("approach", "advance", "retreat")
"""Straight ways near the table, on which the force on the hand is bounded; a lift takes it off what it presses on."""


class Stages:
    """What a pick and the way home do with the arm; all of it raises DgsError.

    Attributes:
        times: seconds of each stage so far.
        at_home: the arm has been brought home.
    """

    def __init__(self, robot: Robot, planner: PickPlanner):
        """Nothing has moved yet."""
        self._robot, self._planner = robot, planner
        self._clock = StageClock()
        self.times = self._clock.times
        self.at_home = False

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Enter a stage; an error that leaves it carries its name."""
        self._robot.enter(name)
        with self._clock(name):
            try:
                yield
            except DgsError as error:
                raise DgsError(error.code, f"{name}: {error.message}") from error

    def drive(self, plan: PickPlan, stage: str, hand_joints: Array) -> None:
        """A stage of the plan, with a hand of (J,) joints [rad]."""
        with self(stage):
            self.move(plan.trajectories[stage], stage, hand_joints)

    def drive_off(self, plan: PickPlan, stage: str, hand_joints: Array) -> None:
        """The same from where the arm stands now, which may be beside the plan."""
        with self(stage):
            off = self._planner.plan_off(self._robot.watch.arm_joints(), plan, stage)
            self.move(off, stage, hand_joints)

    def move(self, trajectory: Trajectory, stage: str, hand_joints: Array) -> None:
        """One trajectory; near the table it ends where the hand presses on something (FORCE_LIMIT)."""
        if stage not in _BOUNDED:
            return self._robot.move_arm(trajectory, hand_joints)
        pressed = self._robot.watch.force.check
        try:
            self._robot.move_arm(trajectory, hand_joints, meanwhile=pressed)
        except DgsError as error:
            if error.code is ErrorCode.TRAJECTORY_ABORTED:  # its controller may end the motion before we do
                pressed()
            raise

    def follow(self, trajectories: Sequence[Trajectory], situation: ArmSituation) -> None:
        """The hand stays as it is."""
        for trajectory in trajectories:
            self._robot.move_arm(trajectory, situation.hand_joints)

    def drive_home(self, look: bool = False) -> None:
        """From the measured state, the hand as it is; `look`: with the newest cloud, not that of the pick."""
        robot = self._robot
        with self("home"):
            self._follow_once_settled(
                self._planner.plan_home, (lambda: robot.look(fresh=False)) if look else robot.situation
            )
        self.at_home = True

    def ease_off(self, rises: Sequence[float]) -> None:
        """Up in such steps [m], until the hand presses with half the bound."""
        for rise in rises:
            self.back_off(rise)
            if self._robot.watch.force.eased:
                break

    def back_off(self, rise: float) -> None:
        """So far up from what the hand has met [m], in the shape that it has."""
        shift = np.array([0.0, 0.0, rise])

        def up(situation: ArmSituation) -> list[Trajectory]:
            return [self._planner.plan_shift(situation.arm_joints, shift)]

        with self("back_off"):
            self._follow_once_settled(up, self._robot.situation)
        self._robot.watch.force.forget()

    def _follow_once_settled(
        self, plan: Callable[[ArmSituation], list[Trajectory]], now: Callable[[], ArmSituation]
    ) -> None:
        """Plan from how things stand and follow that; again, for a while, where nothing could be sent."""
        begun = time.monotonic()
        while True:
            situation = now()
            try:
                return self.follow(plan(situation), situation)
            except DgsError as error:
                if error.code not in _UNSETTLED or time.monotonic() - begun > _SETTLING:
                    raise
            self._robot.watch.wait(0.1)

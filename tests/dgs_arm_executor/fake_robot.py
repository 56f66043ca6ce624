"""A robot and a planner that a test of the arm's goals tells what to do: what no simulation reaches at will."""

from __future__ import annotations

import time
from typing import cast

import numpy as np

from dgs_arm_executor.execution import Execution
from dgs_arm_executor.force_guard import ForceGuard
from dgs_arm_executor.grasp_state import HoldSettings
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.situation import ArmSituation, Load
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from tests.support.grasps import top_grasps

FINAL = np.tile([0.0, 0.6, 0.4, 0.4], 5)
GRASP = top_grasps(np.zeros(3), final=FINAL)[0]
OVER_THE_BIN = np.zeros(6)
GRIPPING, OPEN = FINAL - 0.1, np.zeros(20)
PRESSING, LIMP = np.full(20, 0.3), np.zeros(20)
STOPPED = DgsError(ErrorCode.STOPPED, "stopped")
JAMMED = DgsError(ErrorCode.HAND_BLOCKED, "jammed")


class FakeRobot:
    """Holds an object; `trouble` ends the opening of its hand, which then comes to rest in a state or says nothing."""

    def __init__(self, trouble: DgsError | None, rest: ArmSituation | None) -> None:
        self.trouble, self.rest = trouble, rest
        self.watch, self.force, self.wait = self, ForceGuard(), time.sleep
        self.load: Load | None = Load(GRASP)
        self.obstructed = False
        self.looks = 0
        self.done: list[str] = []
        self.shapes: list[bool] = []
        self.postures: list[np.ndarray] = []

    def enter(self, stage: str) -> None:
        self.stage = stage
        self.done.append(stage)

    def situation(self) -> ArmSituation:
        return ArmSituation(OVER_THE_BIN, GRIPPING, PRESSING, load=self.load)

    def arm_joints(self) -> np.ndarray:
        return OVER_THE_BIN

    def look(self, fresh: bool) -> ArmSituation:
        assert not fresh, "the way home must not wait for a camera"
        self.looks += 1
        return self.situation()

    def hand_at_rest(self) -> ArmSituation:
        if self.rest is None:
            raise DgsError(ErrorCode.HAND_UNAVAILABLE, "silent")
        return self.rest

    def open_hand(self, opened: np.ndarray = OPEN) -> DgsError | None:
        self.opened = opened
        self.postures.append(opened)
        self.shapes.append(opened is OPEN)
        if self.trouble is not None and self.trouble.code == ErrorCode.STOPPED:
            raise self.trouble
        return self.trouble

    def move_arm(self, trajectory: Trajectory, hand_joints: np.ndarray, **_: object) -> None:
        self.done.append("arm moved")

    def set_payload(self, holding: bool) -> None:
        self.done.append("payload with object" if holding else "payload of the hand")


class Seer(FakeRobot):
    """Sees a cloud."""

    def __init__(self, seen: np.ndarray) -> None:
        super().__init__(None, None)
        self.seen, self.load, self.candidate = seen, None, -1

    def look(self, fresh: bool) -> ArmSituation:
        assert fresh, "an old cloud is no news"
        return ArmSituation(OVER_THE_BIN, OPEN, cloud=ObstacleCloud.from_points(self.seen))


class FakePlanner:
    """`blocked`: so many ways home are not found; `room`: for the open hand; `far`: the bin is."""

    home = np.ones(6)

    def __init__(self, blocked: int = 0, room: bool = True, far: bool = False) -> None:
        self.blocked, self.room, self.far = blocked, room, far
        self.nothing_held = False

    def opened(self, situation: ArmSituation, otherwise: np.ndarray) -> np.ndarray:
        return HAND.open_hand if self.room else otherwise

    def plan_to_bin(self, situation: ArmSituation) -> list[None]:
        assert (situation.load is None) == self.nothing_held
        if self.far:
            raise DgsError(ErrorCode.NO_PATH, "something stands in the way")
        return [None]

    def plan_home(self, situation: ArmSituation) -> list[None]:
        assert situation.load is None
        self.blocked -= 1
        if self.blocked >= 0:
            code = ErrorCode.NO_PATH if self.blocked % 2 else ErrorCode.SAFETY_ENVELOPE
            raise DgsError(code, "something falls, or the arm still brakes")
        return [None]


def execution(robot: FakeRobot, planner: FakePlanner) -> Execution:
    """A goal of the two; thumb and fingers that touch each other count as held off."""
    return Execution(cast(Robot, robot), cast(PickPlanner, planner), HoldSettings(own_contact=-1.0))

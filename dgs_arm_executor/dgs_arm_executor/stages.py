"""What the sequences of a pick and of the way home share: the robot's contract, stages with their times, the hand."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dgs_arm_executor.grasp_state import HoldSettings, dropped_out, let_go
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_types import OPEN_HAND
from dgs_arm_executor.timing import Trajectory
from dgs_arm_executor.watch import HandReading
from dgs_description.errors import DgsError, ErrorCode

Array = NDArray[np.float64]

HOLD_CODES = frozenset({ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP})
"""After these nothing moves any more, the hand included, until a reset."""


class Robot(Protocol):
    """What a sequence needs of arm and hand. Every method raises DgsError when it is interrupted."""

    def arm_joints(self) -> Array:
        """(6,) measured just now [rad]."""

    def hand_joints(self) -> Array:
        """(20,) measured just now [rad]."""

    def hand_reading(self) -> HandReading:
        """Joints and torques measured just now."""

    def hand_at_rest(self) -> HandReading:
        """Joints and torques of a hand that was just stopped, once its fingers are at rest."""

    def observed_cloud(self, arm_joints: Array, hand_joints: Array, fresh: bool) -> ObstacleCloud:
        """The newest cloud, without the robot; `fresh`: an old one or none at all is refused."""

    def move_arm(self, trajectory: Trajectory, hand_joints: Array) -> None:
        """Follow a trajectory to its end, the hand being in the given shape."""

    def move_hand(
        self, joints: Array, mode: Literal["position", "grasp"], uninterrupted: bool = False
    ) -> None:
        """Bring the hand to (20,) joints, or close it towards them; `uninterrupted`: also after a cancel."""

    def set_payload(self, holding: bool) -> None:
        """Tell the robot what it carries: the hand alone, or the hand with an object."""

    def enter(self, stage: str, candidate: int) -> None:
        """Say which stage begins."""


class Stages:
    """Names the stages of one goal and takes their times.

    Attributes:
        times: seconds by stage.
        candidate: index of the grasp in work; -1 = none.
    """

    def __init__(self, robot: Robot) -> None:
        """Nothing has begun."""
        self._robot = robot
        self.times: dict[str, float] = {}
        self.candidate = -1

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Enter a stage; an error that leaves it carries its name."""
        began = time.perf_counter()
        self._robot.enter(name, self.candidate)
        try:
            yield
        except DgsError as error:
            raise type(error)(error.code, f"{name}: {error.message}") from error
        finally:
            self.times[name] = self.times.get(name, 0.0) + time.perf_counter() - began


def is_hand_fault(error: DgsError) -> bool:
    """Whether the hand itself has failed, not somebody who interrupted it."""
    return 300 <= int(error.code) < 400


def has_let_go(
    robot: Robot, before: HandReading, error: DgsError, settings: HoldSettings | None = None
) -> bool:
    """Whether a hand that an error has ended while it opened has let go of what it held; False if nobody can say.

    Args:
        robot: its hand.
        before: the hand while it held.
        error: a fault of the hand itself (jammed fingers press on what jams them: their torques say nothing), or who
            interrupted it.
        settings: thresholds.
    """
    try:
        now = robot.hand_at_rest()
    except DgsError:
        return False
    if let_go(now.joints, before.joints, settings):
        return True
    return not is_hand_fault(error) and dropped_out(now.torques, before.torques, settings)


def open_hand(robot: Robot) -> DgsError | None:
    """Open the hand even if somebody cancels meanwhile; the hand's own fault is returned, others are raised."""
    try:
        robot.move_hand(OPEN_HAND, "position", uninterrupted=True)
    except DgsError as error:
        if not is_hand_fault(error):
            raise
        return error
    return None

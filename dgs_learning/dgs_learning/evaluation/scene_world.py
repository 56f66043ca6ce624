"""A table with objects and one hand carried through the air (no arm): executes grasps by contact physics alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_description.pick import LIFT, STAND_OFF
from dgs_learning.synthesis.scenes import Scene
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.hand_world import Wear, open_world

Array = NDArray[np.float64]

CARRY_SPEED = 0.25
"""[m/s]"""
CLOSING_SPEED = 2.09
CLOSING_TIME = 1.2
SUCCESS_HEIGHT = 0.10
"""An object counts as lifted when it is this much higher than before (paper) [m]."""
MOVED = 0.010
"""An object that is moved farther than this before the hand closes was in its way [m]."""
SHAKE = 0.02
"""Amplitude of the shake after the lift [m]."""
SETTLING_TIME = 0.5
"""[s]"""
HOLD = 0.25
"""After the shake [s]."""
FAR_ABOVE = transform(position=(0, 0, 1.0))
"""Where the hand waits."""


class Outcome(Enum):
    """How an attempt ended."""

    SUCCESS = "success"
    APPROACH_CONTACT = "approach contact"
    MISSED = "missed"
    SLIPPED = "slipped"
    LOST_IN_LIFT = "lost in lift"


@dataclass(frozen=True)
class Attempt:
    """Result of one executed grasp.

    Attributes:
        outcome: how it ended.
        object_index: which object of the scene was lifted or, failing that, was touched and nearest to the TCP, or just
            nearest; -1 = none left.
        joints: (20,) measured after closing [rad].
        T_table_tcp: (4, 4) of the hand, measured after closing.
        closed_poses: (4, 4) pose of every object after closing.
    """

    outcome: Outcome
    object_index: int
    joints: Array
    T_table_tcp: Array
    closed_poses: dict[int, Array]


class SceneWorld:
    """A settled scene with a carried hand; use as a context manager. Frame: *table*."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        scene: Scene,
        engine: str = "pybullet",
        friction: float | None = None,
        wear: Wear | None = None,
    ):
        self.models = [models[k] for k in scene.objects]
        self.world = open_world(engine, self.models, list(scene.T_table_object), True, friction, wear)
        self._park()

    def __enter__(self) -> SceneWorld:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    @property
    def left(self) -> list[int]:
        """Indices of the objects that are still there."""
        return self.world.left

    def object_poses(self) -> dict[int, Array]:
        """(4, 4) pose of every object that is left."""
        return self.world.object_poses()

    def scene(self) -> tuple[list[ObjectModel], list[Array]]:
        """Models and poses of the objects that are left, for the camera."""
        poses = self.object_poses()
        return [self.models[i] for i in poses], list(poses.values())

    def remove(self, index: int) -> None:
        """Take an object off the table."""
        self.world.remove(index)

    def drop_lost(self, half_area: tuple[float, float]) -> None:
        """Forget objects that rolled out of the area (half extents in x and y) [m]."""
        for index, T in self.object_poses().items():
            if abs(T[0, 3]) > half_area[0] or abs(T[1, 3]) > half_area[1]:
                self.remove(index)

    def settle(self) -> None:
        """Let everything come to rest with the hand parked."""
        self._wait(SETTLING_TIME)

    def _wait(self, duration: float) -> None:
        for _ in range(round(duration / self.world.period)):
            self.world.step()

    def _park(self) -> None:
        self.world.put_hand(FAR_ABOVE, np.zeros(20))

    def _move(self, T_start: Array, shift: Array) -> None:
        """Carry the hand along a straight line of `shift` (3,) [m]."""
        steps = max(1, round(float(np.linalg.norm(shift)) / CARRY_SPEED / self.world.period))
        for step in range(1, steps + 1):
            T = T_start.copy()
            T[:3, 3] += shift * (step / steps)
            self.world.carry(T)
            self.world.step()

    def execute(self, grasp: GraspSet) -> Attempt:
        """Approach in the pre-grasp shape, close, lift, shake; then open, and the hand leaves.

        Args:
            grasp: a single one, frame *table*.
        """
        before, T_table_tcp = self.object_poses(), grasp.pose
        start = T_table_tcp.copy()
        start[:3, 3] -= STAND_OFF * T_table_tcp[:3, 2]
        self.world.put_hand(start, grasp.pre_grasp_joints)
        self._move(start, STAND_OFF * T_table_tcp[:3, 2])
        now = self.object_poses()
        moved = max((float(np.linalg.norm(now[i][:3, 3] - before[i][:3, 3])) for i in now), default=0.0)
        self.world.start_closing(grasp, CLOSING_SPEED)
        self._wait(CLOSING_TIME)
        joints, closed_poses = self.world.joints()[0], self.object_poses()
        T_table_hand = self.world.hand_pose()
        touched = {i for i in self.left if self.world.contacts(i)[0]}
        self._move(T_table_tcp, np.array([0, 0, LIFT]))
        lifted = self._lifted(before)
        held = self._shake_and_hold(T_table_tcp, before)
        if held:
            outcome = Outcome.SUCCESS
        elif lifted:
            outcome = Outcome.LOST_IN_LIFT
        elif moved > MOVED:
            outcome = Outcome.APPROACH_CONTACT
        else:
            outcome = Outcome.SLIPPED if touched else Outcome.MISSED
        self._park()
        distance = {
            i: float(np.linalg.norm(before[i][:3, 3] - T_table_tcp[:3, 3])) for i in touched or before
        }
        near = min(distance, key=lambda i: distance[i], default=-1)
        return Attempt(outcome, next(iter(held or lifted), near), joints, T_table_hand, closed_poses)

    def _lifted(self, before: dict[int, Array]) -> list[int]:
        now = self.object_poses()
        return [i for i in now if now[i][2, 3] - before[i][2, 3] > SUCCESS_HEIGHT]

    def _shake_and_hold(self, T_table_tcp: Array, before: dict[int, Array]) -> list[int]:
        T = T_table_tcp.copy()
        T[2, 3] += LIFT
        for direction in ((1, 0, 0), (-2, 0, 0), (1, 1, 0), (0, -2, 0), (0, 1, 0)):
            shift = SHAKE * np.array(direction, float)
            self._move(T, shift)
            T[:3, 3] += shift
        self._wait(HOLD)
        return self._lifted(before)

"""A table with objects and one hand carried through the air (no arm): executes grasps by contact physics alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from dgs_description.frames import Array, inverse, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.pick import LIFT, MOTION_SPEED, STAND_OFF, way_back
from dgs_learning.synthesis.scenes import Scene
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.engines import open_world
from dgs_sim_bridge.world.hand_world import Wear

UP = np.array([0.0, 0.0, LIFT])
"""[m]"""
CARRY_SPEED = 0.25
"""[m/s]"""
CLOSING_SPEED = 2.09
CLOSING_TIME = 1.2
SUCCESS_HEIGHT = 0.10
"""An object counts as lifted when it is this much higher than before (paper) [m]."""
MOVED = 0.010
"""An object that is moved farther than this before the hand closes was in its way, or was pushed [m]."""
SLIP = 0.02
"""An object that has moved so far in the closed hand has slipped: the moment that is kept [m]."""
SHAKE = 0.02
"""Amplitude of the shake after the lift [m]."""
FALLEN = -0.1
"""What is lower has fallen off the table [m]."""
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
    PUSHED = "pushed"


@dataclass(frozen=True)
class Moment:
    """Hand and objects as they are at one instant of an attempt.

    Attributes:
        joints: (J,) [rad].
        T_table_tcp: (4, 4) of the hand.
        objects: (4, 4) pose of every object that is left.
        moved: which of them had moved too far; None = no matter.
    """

    joints: Array
    T_table_tcp: Array
    objects: dict[int, Array]
    moved: int | None = None


@dataclass(frozen=True)
class Attempt:
    """Result of one executed grasp.

    Attributes:
        outcome: how it ended.
        object_index: which object of the scene was lifted or, failing that, was touched and nearest to the TCP, or just
            nearest; of a push, which moved farthest or, where none did, lay nearest to what was to be pushed; -1 = none
            left.
        closed: after closing, or after the motion of a push.
        failed: when an object had moved by `MOVED` before the hand closed, or by `SLIP` in the hand while it was
            lifted, or shaken if it was lost after the lift; None = success.
    """

    outcome: Outcome
    object_index: int
    closed: Moment
    failed: Moment | None


class SceneWorld:
    """A settled scene with a carried hand; use as a context manager. Frame: *table*."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        scene: Scene,
        engine: str = "pybullet",
        friction: float | None = None,
        wear: Wear | None = None,
        edge: float | None = None,
    ):
        """Put a scene of the catalogue `models` into an engine; the others as in `open_world`."""
        self.models = [models[k] for k in scene.objects]
        poses = list(scene.T_table_object)
        self.world = open_world(engine, self.models, poses, True, friction, wear, edge)
        self._watch(lambda: None)
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
        """Forget objects that rolled out of the area (half extents in x and y) [m], or off the table."""
        for index, T in self.object_poses().items():
            if abs(T[0, 3]) > half_area[0] or abs(T[1, 3]) > half_area[1] or T[2, 3] < FALLEN:
                self.remove(index)

    def settle(self) -> None:
        """Let everything come to rest with the hand parked."""
        self._wait(SETTLING_TIME)

    def _watch(self, moved: Callable[[], int | None]) -> None:
        """From now on keep the first moment at which this names an object."""
        self._find_moved = moved
        self._kept: Moment | None = None

    def _watch_grip(self, index: int) -> None:
        """Keep the moment at which this object has moved by `SLIP` in the hand."""

        def in_hand() -> Array:
            return (inverse(self.world.hand_pose()) @ self.world.object_pose(index))[:3, 3]

        held = in_hand()
        self._watch(lambda: index if np.linalg.norm(in_hand() - held) > SLIP else None)

    def _moment(self, moved: int | None = None) -> Moment:
        return Moment(self.world.posture(), self.world.hand_pose(), self.object_poses(), moved)

    def _step(self) -> None:
        self.world.step()
        if self._kept is None and (moved := self._find_moved()) is not None:
            self._kept = self._moment(moved)

    def _wait(self, duration: float) -> None:
        for _ in range(round(duration / self.world.period)):
            self._step()

    def _park(self) -> None:
        self.world.put_hand(FAR_ABOVE, np.zeros(HAND.joint_count))

    def _move(self, T_start: Array, shift: Array, speed: float = CARRY_SPEED) -> None:
        """Carry the hand along a straight line of `shift` (3,) [m]."""
        steps = max(1, round(float(np.linalg.norm(shift)) / speed / self.world.period))
        for step in range(1, steps + 1):
            T = T_start.copy()
            T[:3, 3] += shift * (step / steps)
            self.world.carry(T)
            self._step()

    def execute(self, grasp: GraspSet) -> Attempt:
        """Approach in the pre-grasp shape and along the motion, close, lift, shake; then the hand is gone at once.

        A push ends with the motion: the hand leaves level back, then up. So does a drag: the hand opens, and leaves up.

        Args:
            grasp: a single one, frame *table*.
        """
        before, T_table_tcp = self.object_poses(), grasp.closing_pose
        start = grasp.pose
        start[:3, 3] -= STAND_OFF * start[:3, 2]
        self.world.put_hand(start, grasp.pre_grasp_joints)
        self._watch(lambda: self._moved(before))
        self._move(start, STAND_OFF * start[:3, 2])
        if grasp.drags:
            self._close(grasp)
        if grasp.motion.any():
            self._move(grasp.pose, grasp.motion, MOTION_SPEED)
        if not grasp.holds:
            return self._moved_on(grasp, before)
        moved = self._moved(before)
        in_the_way = self._kept or self._moment(moved)
        self._close(grasp)
        closed = self._moment()
        touched = {i for i in self.left if self.world.contacts(i)}
        distance = {
            i: float(np.linalg.norm(before[i][:3, 3] - T_table_tcp[:3, 3])) for i in touched or before
        }
        near = min(distance, key=lambda i: distance[i], default=-1)
        if touched:
            self._watch_grip(near)
        self._move(T_table_tcp, UP)
        lifted, slipped = self._lifted(before), self._kept or self._moment()
        if lifted:
            self._watch_grip(lifted[0])
        held = self._shake_and_hold(T_table_tcp, before)
        if held:
            outcome, failed = Outcome.SUCCESS, None
        elif lifted:
            outcome, failed = Outcome.LOST_IN_LIFT, self._kept or self._moment()
        elif moved is not None:
            outcome, failed = Outcome.APPROACH_CONTACT, in_the_way
        else:
            outcome, failed = (Outcome.SLIPPED, slipped) if touched else (Outcome.MISSED, closed)
        self._watch(lambda: None)
        self._park()
        return Attempt(outcome, next(iter(held or lifted), near), closed, failed)

    def _close(self, grasp: GraspSet) -> None:
        self._watch(lambda: None)
        self.world.start_closing(grasp, CLOSING_SPEED)
        self._wait(CLOSING_TIME)

    def _moved_on(self, grasp: GraspSet, before: dict[int, Array]) -> Attempt:
        """The end of a push or a drag: the hand leaves what it has moved, and then up."""
        self._watch(lambda: None)
        after = self._moment()

        def pushed(index: int) -> tuple[float, float]:
            place = before[index][:3, 3]
            way = float(np.linalg.norm(after.objects[index][:3, 3] - place))
            return way if way > MOVED else 0.0, -float(np.linalg.norm((place - grasp.reference_point)[:2]))

        T_table_tcp, back = grasp.closing_pose, way_back(grasp)
        if grasp.drags:
            none = np.zeros_like(grasp.active_fingers)
            self._close(replace(grasp, grasp_joints=grasp.pre_grasp_joints, active_fingers=none))
        self._move(T_table_tcp, back)
        T_table_tcp[:3, 3] += back
        self._move(T_table_tcp, UP)
        self._park()
        return Attempt(Outcome.PUSHED, max(before, key=pushed, default=-1), after, None)

    def _moved(self, before: dict[int, Array]) -> int | None:
        """An object that has moved by `MOVED` since; None = there is none."""
        now = self.object_poses()
        return next((i for i in now if np.linalg.norm(now[i][:3, 3] - before[i][:3, 3]) > MOVED), None)

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

"""Rollouts: the likeliest grasps are done in a physics engine first, on things as the planner believes them to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.pick import way_up
from dgs_grasp_planner.believed import solid
from dgs_grasp_planner.contact.height_field import HeightField

if TYPE_CHECKING:
    from dgs_sim_bridge.world.mujoco_hand import MujocoHandWorld

REACH = 0.08
"""Things farther from the TCP, seen from above, are left out [m]."""
SETTLING, HOLD = 0.5, 0.1
"""Things that were cut apart come to rest for so long, and one that was shaken is held so long [s]."""
APPROACH, LIFT, SHAKE = 0.05, 0.08, 0.02
"""The hand comes straight over so far, lifts and shakes by so much [m]."""
SPEED, CLOSING_SPEED = 0.25, 2.09
"""Of the hand [m/s] and of its joints [rad/s]."""
CLOSING_TIME, STILL, STILL_FOR = 1.2, 0.1, 0.1
"""The fingers close for so long [s], or until they were slower than this [rad/s] for so long [s]."""
PHYSICS_STEPS = 2
"""In a control period: coarser than the judge's."""
RISEN = 0.6
"""Share of the lift by which something must have risen."""
HELD, FAILED = 1.5, 0.3
"""The odds that a grasp holds are so many times what they were when it held in its rollout, and when it did not."""


def roll_out(
    grasps: GraspSet,
    in_turn: Callable[[GraspSet], NDArray[np.int64]],
    field: HeightField | None,
    edge: float | None,
    tries: int,
) -> GraspSet:
    """Roll grasps out until the one whose turn it is has been, and move their scores by what was seen.

    Grasps with a motion are not rolled out: a height field does not say how far something reaches over an edge.

    Args:
        grasps: frame *table*.
        in_turn: (K,) the order of grasps by their scores.
        field: what stands there.
        edge: the table is where x is larger [m]; None = everywhere.
        tries: rollouts at most.
    """
    if field is None or not len(grasps):
        return grasps
    tried = set[int]()
    scenes: dict[tuple[int, ...], BelievedScene] = {}
    with ExitStack() as stack:
        for _ in range(tries):
            first = int(in_turn(grasps)[0])
            grasp = grasps[first]
            if first in tried or not grasp.holds or grasp.motion.any():
                break
            tried.add(first)
            things = _things(field.separated, grasp)
            if things not in scenes:
                scenes[things] = stack.enter_context(BelievedScene(field.separated, things, edge))
            odds = HELD if scenes[things].holds(grasp) else FAILED
            score = grasps.score.copy()
            score[first] *= odds / (odds * score[first] + 1.0 - score[first])
            grasps = replace(grasps, score=score)
    return grasps


def _things(field: HeightField, grasp: GraspSet) -> tuple[int, ...]:
    """Numbers of the things that a hand may meet."""
    cells = np.argwhere(field.owner > 0)
    near = np.linalg.norm(field.middles(cells) - grasp.closing_pose[:2, 3], axis=1) < REACH
    return tuple(np.unique(field.owner[tuple(cells[near].T)]).tolist())


@cache
def engine() -> type[MujocoHandWorld]:
    """The physics, loaded by the first call, which takes a moment."""
    from dgs_sim_bridge.world.mujoco_hand import MujocoHandWorld

    return MujocoHandWorld


class BelievedScene:
    """A hand over some things of a field, each at rest where it was seen. A context manager."""

    def __init__(self, field: HeightField, things: Sequence[int], edge: float | None) -> None:
        """Put things, by their numbers, on a table that is where x is larger than `edge` [m]."""
        found = [body for number in things if (body := solid(field, number)) is not None]
        bodies, poses = [body for body, _ in found], [pose for _, pose in found]
        self._world = engine()(bodies, poses, table=True, edge=edge, steps=PHYSICS_STEPS)
        self._wait(SETTLING)
        self._rest = self._world.object_poses()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._world.close()

    def holds(self, grasp: GraspSet) -> bool:
        """Whether the hand has something in it after approach, closing, lift and shake."""
        world = self._world
        for index, T in self._rest.items():
            world.place(index, T)
        T = grasp.pose
        T[:3, 3] -= APPROACH * T[:3, 2]
        world.put_hand(T, grasp.pre_grasp_joints)
        T = self._carry(T, APPROACH * T[:3, 2])
        self._close(grasp)
        T = self._carry(T, way_up(grasp, LIFT))
        for way in ((1, 0, 0), (-2, 0, 0), (1, 1, 0), (0, -2, 0), (0, 1, 0)):
            if not self._risen():
                return False
            T = self._carry(T, SHAKE * np.array(way, float))
        self._wait(HOLD)
        return self._risen()

    def _risen(self) -> bool:
        now = self._world.object_poses()
        return any(now[k][2, 3] - T[2, 3] > RISEN * LIFT for k, T in self._rest.items())

    def _wait(self, duration: float) -> None:
        for _ in range(round(duration / self._world.period)):
            self._world.step()

    def _carry(self, start: Array, way: Array) -> Array:
        """Carry the hand from a pose (4, 4) along a straight line (3,) [m]; returns the pose at its end."""
        steps = max(1, round(float(np.linalg.norm(way)) / SPEED / self._world.period))
        for step in range(1, steps + 1):
            T = transform(start[:3, :3], start[:3, 3] + way * (step / steps))
            self._world.carry(T)
            self._world.step()
        return T

    def _close(self, grasp: GraspSet) -> None:
        world, slow = self._world, 0.0
        world.start_closing(grasp, CLOSING_SPEED)
        before = world.joints()[0]
        for _ in range(round(CLOSING_TIME / world.period)):
            world.step()
            now = world.joints()[0]
            slow = slow + world.period if np.abs(now - before).max() < STILL * world.period else 0.0
            before = now
            if slow > STILL_FOR:
                return

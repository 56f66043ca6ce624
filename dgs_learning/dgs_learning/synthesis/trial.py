"""Physics of a trial: close a floating hand around one object and shake it along six axes (paper, section V-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dgs_description.frames import Array, inverse
from dgs_description.grasp import GraspSet
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.engines import open_world

CLOSING_TIME = 0.5
"""[s]"""
CLOSING_SPEED = 4.0
"""[rad/s]: in free space only the final contact counts, so closing is faster than on the real hand."""
MAX_SHIFT_CLOSING = 0.04
"""How far the object may move while the hand closes [m]."""
AXES = np.array([(0, 0, -1), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], dtype=np.float64)


@dataclass(frozen=True)
class Rules:
    """What a closed hand has to stand: a force along all six axes in turn. By default the paper's six-axis test.

    Attributes:
        force: on the object, per mass [m/s^2], along each axis for so many `seconds`.
        max_shift, max_turn: how far the object may move in the hand [m, rad].
        fresh: every axis begins with a hand that has just closed; else the state is carried on.
        mass: of the object [kg], friction: of the hand on it; None = its own, the engine's.
        max_depth: deepest penetration of the final hand [m].
    """

    force: float = 9.81
    seconds: float = 100 / 240
    max_shift: float = 0.02
    max_turn: float = np.pi
    fresh: bool = False
    mass: float | None = None
    friction: float | None = None
    max_depth: float = np.inf


RULES = {
    "paper": Rules(),
    "dexgraspbench": Rules(10.0, 2.0, 0.05, float(np.deg2rad(15.0)), True, 0.1, 0.6, 0.010),
}
"""Of the paper (section V-A), and as DexGraspBench publishes its own (there in MuJoCo)."""


@dataclass(frozen=True)
class Closed:
    """A hand that has closed.

    Attributes:
        touching: thumb and a finger touch the object, and it stayed near.
        joints: (J,) measured [rad].
        T_object_tcp: (4, 4) pose of the hand relative to where the object ended up.
    """

    touching: bool
    joints: Array
    T_object_tcp: Array


_CLOSING = Rules(seconds=CLOSING_TIME, max_shift=MAX_SHIFT_CLOSING)


class FloatingHand:
    """A world with one hand fixed in space and one free object; use as a context manager."""

    def __init__(self, model: ObjectModel, engine: str = "pybullet", friction: float | None = None):
        self.world = open_world(engine, [model], [np.eye(4)], table=False, friction=friction)
        self.T_world_tcp = np.eye(4)

    def __enter__(self) -> FloatingHand:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    def _stays(self, T_before: Array, rules: Rules) -> bool:
        T = inverse(T_before) @ self.world.object_pose(0)
        turn = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1.0, 1.0))
        return bool(np.linalg.norm(T[:3, 3]) <= rules.max_shift and turn <= rules.max_turn)

    def _run(self, T_before: Array, rules: Rules) -> bool:
        """Let the rules' time pass; False as soon as a glance, five in all, finds that the object has moved."""
        steps = round(rules.seconds / self.world.period)
        glance = -(-steps // 5)
        for step in range(steps):
            self.world.step()
            if step % glance == glance - 1 and not self._stays(T_before, rules):
                return False
        return self._stays(T_before, rules)

    def close(self, grasp: GraspSet, T_world_object: Array | None = None) -> Closed:
        """Close without gravity, from the pre-grasp to the grasp joints plus margin.

        Args:
            grasp: one grasp in the frame of the object.
            T_world_object: (4, 4) where the object starts; None = at the origin.
        """
        self._closed = grasp, T_world_object
        T_start = np.eye(4) if T_world_object is None else T_world_object
        self.T_world_tcp = T_start @ grasp.pose
        self.world.put_hand(self.T_world_tcp, grasp.pre_grasp_joints)
        self.world.place(0, T_start)
        self.world.set_gravity(np.zeros(3))
        self.world.start_closing(grasp, CLOSING_SPEED)
        near = self._run(T_start, _CLOSING)
        fingers = self.world.contacts(0)
        return Closed(
            touching=near and 0 in fingers and len(fingers) >= 2,
            joints=self.world.joints()[0],
            T_object_tcp=inverse(self.world.object_pose(0)) @ self.T_world_tcp,
        )

    def shake(self, rules: Rules = RULES["paper"]) -> bool:
        """Whether the hand that has closed stands the test: the object stays, and two fingers still touch."""
        T_closed = self.world.object_pose(0)
        for k, axis in enumerate(AXES):
            if k and rules.fresh:
                self.close(*self._closed)
                T_closed = self.world.object_pose(0)
            self.world.set_gravity(self.T_world_tcp[:3, :3] @ axis * rules.force)
            if not self._run(T_closed, rules) or len(self.world.contacts(0)) < 2:
                return False
        return True

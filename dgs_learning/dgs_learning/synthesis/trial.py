"""Physics part of a trial.

Close a free-floating hand around one object and shake it along six axes (paper, section V-A).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import inverse
from dgs_description.grasp import GraspSet
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.hand_world import open_world
from dgs_sim_bridge.world.physics import PHYSICS

Array = NDArray[np.float64]

CLOSING_TIME = 0.4
"""[s]"""
CLOSING_SPEED = 4.0
"""[rad/s]: in free space only the final contact counts, so closing is faster than on the real hand."""
GRAVITY_TIME = 100 / 240
"""Gravity acts so long along each axis [s]: the paper's 100 steps."""
MAX_SHIFT_CLOSING = 0.04
MAX_SHIFT_GRAVITY = 0.02
"""How far the object may move in the hand [m]."""
AXES = np.array([(0, 0, -1), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], dtype=np.float64)


@dataclass(frozen=True)
class Closed:
    """A hand that has closed.

    Attributes:
        touching: thumb and a finger touch the object, and it stayed near.
        joints: (20,) measured [rad].
        T_object_tcp: (4, 4) pose of the hand relative to where the object ended up.
    """

    touching: bool
    joints: Array
    T_object_tcp: Array


class FloatingHand:
    """A world with one hand fixed in space and one free object; use as a context manager."""

    def __init__(self, model: ObjectModel, engine: str = "pybullet", friction: float | None = None):
        self.world = open_world(engine, [model], [np.eye(4)], table=False, friction=friction)
        self.T_world_tcp = np.eye(4)

    def __enter__(self) -> FloatingHand:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    def _stays(self, T_before: Array, limit: float) -> bool:
        return float(np.linalg.norm(self.world.object_pose(0)[:3, 3] - T_before[:3, 3])) <= limit

    def _run(self, duration: float, T_before: Array, limit: float) -> bool:
        """Let time pass; False as soon as a glance, five in all, finds the object farther off than `limit`."""
        steps = round(duration / self.world.period)
        glance = -(-steps // 5)
        for step in range(steps):
            self.world.step()
            if step % glance == glance - 1 and not self._stays(T_before, limit):
                return False
        return self._stays(T_before, limit)

    def close(self, grasp: GraspSet, T_world_object: Array | None = None) -> Closed:
        """Close without gravity, from the pre-grasp to the grasp joints plus margin.

        Args:
            grasp: one grasp in the frame of the object.
            T_world_object: (4, 4) where the object starts; None = at the origin.
        """
        T_start = np.eye(4) if T_world_object is None else T_world_object
        self.T_world_tcp = T_start @ grasp.pose
        self.world.put_hand(self.T_world_tcp, grasp.pre_grasp_joints)
        self.world.place(0, T_start)
        self.world.set_gravity(np.zeros(3))
        self.world.start_closing(grasp, CLOSING_SPEED)
        near = self._run(CLOSING_TIME, T_start, MAX_SHIFT_CLOSING)
        fingers, _, _ = self.world.contacts(0)
        return Closed(
            touching=near and 0 in fingers and len(fingers) >= 2,
            joints=self.world.joints()[0],
            T_object_tcp=inverse(self.world.object_pose(0)) @ self.T_world_tcp,
        )

    def shake(self) -> bool:
        """The six-axis test of the hand that has closed.

        Gravity acts along each TCP axis in turn, state carried on. Passed if the object moves less than 2 cm in the
        hand and two fingers still touch.
        """
        T_closed = self.world.object_pose(0)
        for axis in AXES:
            self.world.set_gravity(self.T_world_tcp[:3, :3] @ axis * PHYSICS.gravity)
            if not self._run(GRAVITY_TIME, T_closed, MAX_SHIFT_GRAVITY):
                return False
            if len(self.world.contacts(0)[0]) < 2:
                return False
        return True

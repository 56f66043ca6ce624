"""Physics part of a trial.

Close a free-floating hand around one object in PyBullet and shake it along six axes (paper, section V-A).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pybullet
from numpy.typing import NDArray

from dgs_description.frames import inverse, to_quaternion
from dgs_description.grasp import GraspSet
from dgs_hand_driver.admittance import closing_target
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import (
    PHYSICS,
    HandController,
    PhysicsSettings,
    add_hand,
    add_object,
    body_pose,
    new_client,
    set_body_pose,
)

Array = NDArray[np.float64]

CLOSING_TIME = 0.4
"""[s]"""
CLOSING_SPEED = 4.0
"""[rad/s]: in free space only the final contact counts, so closing is faster than on the real hand."""
TRIAL_PHYSICS = replace(PHYSICS, rolling_friction=0.0)
"""Without rolling friction, which keeps balls from rolling over a table, a contact has fewer constraints: 82 paired
trials took 11 % less time, 69 instead of 68 were stable, and penetration was the same."""
GRAVITY_STEPS = 100
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

    def __init__(self, model: ObjectModel, settings: PhysicsSettings = TRIAL_PHYSICS):
        self.settings = settings
        self.client = new_client(settings)
        self.hand = add_hand(self.client, True, settings)
        self.controller = HandController(self.client, self.hand, settings)
        self.object = add_object(self.client, model, np.eye(4), settings)
        self.T_world_tcp = np.eye(4)

    def __enter__(self) -> FloatingHand:
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(physicsClientId=self.client)

    def _gravity(self, vector: Array) -> None:
        pybullet.setGravity(*vector.tolist(), physicsClientId=self.client)

    def _step(self) -> None:
        self.controller.step_admittance()
        pybullet.stepSimulation(physicsClientId=self.client)

    def _shift(self, T_before: Array) -> float:
        return float(np.linalg.norm(body_pose(self.client, self.object)[:3, 3] - T_before[:3, 3]))

    def close(self, grasp: GraspSet, T_world_object: Array | None = None) -> Closed:
        """Close without gravity, from the pre-grasp to the grasp joints plus margin.

        Args:
            grasp: one grasp in the frame of the object.
            T_world_object: (4, 4) where the object starts; None = at the origin.
        """
        T_start = np.eye(4) if T_world_object is None else T_world_object
        self.T_world_tcp = T_start @ grasp.pose
        where, quaternion = to_quaternion(self.T_world_tcp)
        pybullet.resetBasePositionAndOrientation(
            self.hand, where.tolist(), quaternion.tolist(), physicsClientId=self.client
        )
        set_body_pose(self.client, self.object, T_start)
        self.controller.reset(grasp.pre_grasp_joints)
        self._gravity(np.zeros(3))
        target = closing_target(grasp.grasp_joints, grasp.active_fingers)
        self.controller.start_closing(target, grasp.active_fingers, CLOSING_SPEED)
        for step in range(round(CLOSING_TIME / self.settings.time_step)):
            self._step()
            if step % 20 == 19 and self._shift(T_start) > MAX_SHIFT_CLOSING:
                break
        fingers, _, _ = self.controller.contacts(self.object)
        return Closed(
            touching=0 in fingers and len(fingers) >= 2 and self._shift(T_start) <= MAX_SHIFT_CLOSING,
            joints=self.controller.state()[0],
            T_object_tcp=inverse(body_pose(self.client, self.object)) @ self.T_world_tcp,
        )

    def shake(self) -> bool:
        """The six-axis test of the hand that has closed.

        Gravity acts for 100 steps along each TCP axis, state carried on. Passed if the object moves less than 2 cm in
        the hand and two fingers still touch.
        """
        T_closed = body_pose(self.client, self.object)
        for axis in AXES:
            self._gravity(self.T_world_tcp[:3, :3] @ axis * self.settings.gravity)
            for step in range(GRAVITY_STEPS):
                self._step()
                if step % 25 == 24 and self._shift(T_closed) > MAX_SHIFT_GRAVITY:
                    return False
            if len(self.controller.contacts(self.object)[0]) < 2:
                return False
        return True

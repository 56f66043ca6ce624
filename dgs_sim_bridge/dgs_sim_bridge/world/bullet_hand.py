"""The carried hand in PyBullet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from dgs_description.frames import Array, to_quaternion
from dgs_description.urdf import urdf_path
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.hand_world import CARRIER_FORCE, HandWorld, Wear
from dgs_sim_bridge.world.physics import (
    PHYSICS,
    HandController,
    add_object,
    body_pose,
    change_links,
    new_world,
    set_body_pose,
)
from dgs_sim_bridge.world.scenes import add_table

IN_SPACE = replace(PHYSICS, rolling_friction=0.0)
"""Without rolling friction, which keeps balls from rolling over a table, a contact has fewer constraints: 82 paired
trials took 11 % less time, 69 instead of 68 were stable, and penetration was the same."""


class BulletHandWorld(HandWorld):
    """See `HandWorld` and `open_world`."""

    def __init__(
        self,
        models: Sequence[ObjectModel],
        poses: Sequence[Array],
        table: bool,
        friction: float | None,
        wear: Wear | None,
        edge: float | None,
    ):
        super().__init__(models, wear)
        settings = PHYSICS if table else IN_SPACE
        if friction is not None:
            settings = replace(settings, hand_friction=friction, table_friction=friction)
        self.period = settings.time_step
        self._bullet = new_world()
        self.set_gravity((0.0, 0.0, -settings.gravity if table else 0.0))
        if table:
            add_table(self._bullet, settings, edge)
        self._bodies = [add_object(self._bullet, m, T, settings) for m, T in zip(models, poses, strict=True)]
        # Fixed in free space, else slowed by nothing but contacts and the carrier.
        self._hand = int(self._bullet.loadURDF(str(urdf_path("floating_hand")), useFixedBase=not table))
        damping = {"linearDamping": 0.0, "angularDamping": 0.0} if table else {}
        change_links(self._bullet, self._hand, **settings.friction(settings.hand_friction), **damping)
        self._motors = HandController(self._bullet, self._hand, settings)
        self._carrier = None
        if table:
            tie = (self._hand, -1, -1, -1, pybullet.JOINT_FIXED, (0, 0, 0), (0, 0, 0), (0, 0, 1))
            self._carrier = self._bullet.createConstraint(*tie)

    def close(self) -> None:
        """Disconnect."""
        self._bullet.disconnect()

    def object_pose(self, index: int) -> Array:
        """(4, 4)."""
        return body_pose(self._bullet, self._bodies[index])

    def place(self, index: int, T_world_object: Array) -> None:
        """Put an object there, at rest."""
        set_body_pose(self._bullet, self._bodies[index], T_world_object)

    def _vanish(self, index: int) -> None:
        self._bullet.removeBody(self._bodies[index])

    def hand_pose(self) -> Array:
        """(4, 4) pose of the TCP."""
        return body_pose(self._bullet, self._hand)

    def _put(self, T_world_tcp: Array, joints: Array) -> None:
        set_body_pose(self._bullet, self._hand, T_world_tcp)
        self._motors.reset(joints)
        if self._carrier is not None:
            self.carry(T_world_tcp)

    def carry(self, T_world_tcp: Array) -> None:
        """Move the point that the hand is tied to."""
        pose = (values.tolist() for values in to_quaternion(T_world_tcp))
        self._bullet.changeConstraint(self._carrier, *pose, maxForce=CARRIER_FORCE)

    def _command(self, joints: Array) -> None:
        self._motors.command(joints, force_scale=self._wear.effort)

    def _state(self) -> tuple[Array, Array]:
        positions, _, torques = self._motors.state()
        return positions, torques

    def contacts(self, index: int) -> set[int]:
        """See `HandController.contacts`."""
        return self._motors.contacts(self._bodies[index])

    def set_gravity(self, vector: ArrayLike) -> None:
        """(3,) [m/s^2]."""
        self._bullet.setGravity(*np.asarray(vector, float).tolist())

    def set_friction(self, value: float) -> None:
        """Of all links of the hand."""
        change_links(self._bullet, self._hand, lateralFriction=value)

    def _advance(self) -> None:
        self._bullet.stepSimulation()

"""Physics part of a trial.

Close a free-floating hand around one object in PyBullet and shake it along six axes (paper, section V-A).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pybullet
from numpy.typing import NDArray

from dgs_description.frames import inverse, to_quaternion, transform
from dgs_description.urdf import urdf_path
from dgs_hand_driver.admittance import closing_target
from dgs_learning.synthesis.clock import StageClock
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import (
    PHYSICS,
    HandController,
    PhysicsSettings,
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
class TrialResult:
    """Outcome of one trial.

    Attributes:
        stable: passed the six-axis test.
        stage: how far it came: "closing", "refused" (closed, but not as wanted), "gravity" or "stable".
        joints: (20,) measured joints after closing [rad].
        T_object_tcp: (4, 4) pose of the hand relative to where the object ended up.
        penetration: deepest penetration that the engine reported [m].
    """

    stable: bool
    stage: str
    joints: Array
    T_object_tcp: Array
    penetration: float


class FloatingHand:
    """A world with one hand fixed in space and one free object; use as a context manager."""

    def __init__(
        self, model: ObjectModel, settings: PhysicsSettings = TRIAL_PHYSICS, clock: StageClock | None = None
    ):
        self.settings = settings
        self.clock = clock or StageClock()
        self.client = new_client(settings)
        self.hand = pybullet.loadURDF(
            str(urdf_path("floating_hand")), useFixedBase=True, physicsClientId=self.client
        )
        for link in range(-1, pybullet.getNumJoints(self.hand, physicsClientId=self.client)):
            pybullet.changeDynamics(
                self.hand,
                link,
                lateralFriction=settings.hand_friction,
                spinningFriction=settings.spinning_friction,
                rollingFriction=settings.rolling_friction,
                physicsClientId=self.client,
            )
        self.controller = HandController(self.client, self.hand, settings)
        self.object = add_object(self.client, model, np.eye(4), settings)

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

    def run(
        self,
        position: Array,
        rotation: Array,
        pre_grasp: Array,
        grasp: Array,
        active: NDArray[np.bool_],
        T_world_object: Array | None = None,
        accept: Callable[[TrialResult], bool] | None = None,
    ) -> TrialResult:
        """Close from `pre_grasp` (20,) to `grasp` (20,) plus margin with the hand at (3,), (3, 3), then shake.

        The hand's pose is given in the frame of the object, which starts at the origin or at `T_world_object` (4, 4).
        Gravity acts only in the six-axis test: 100 steps along each TCP axis, state carried on, passed if the object
        moves less than 2 cm in the hand and two fingers still touch.

        `accept` is asked about what was measured after closing; if it says no, the test, which is most of a trial's
        cost, is left out.
        """
        T_start = np.eye(4) if T_world_object is None else T_world_object
        T_world_tcp = T_start @ transform(rotation, position)
        with self.clock("closing"):
            touching, result = self._close(T_start, T_world_tcp, pre_grasp, grasp, active)
        if not touching:
            return result
        if accept is not None and not accept(result):
            return replace(result, stage="refused")
        with self.clock("gravity"):
            return self._shake(result, T_world_tcp[:3, :3])

    def _close(
        self, T_start: Array, T_world_tcp: Array, pre_grasp: Array, grasp: Array, active: NDArray[np.bool_]
    ) -> tuple[bool, TrialResult]:
        """Close without gravity; whether thumb and a finger touch an object that stayed near, and what was measured."""
        where, quaternion = to_quaternion(T_world_tcp)
        pybullet.resetBasePositionAndOrientation(
            self.hand, where.tolist(), quaternion.tolist(), physicsClientId=self.client
        )
        set_body_pose(self.client, self.object, T_start)
        self.controller.reset(pre_grasp)
        self._gravity(np.zeros(3))
        self.controller.start_closing(closing_target(grasp, active), active, CLOSING_SPEED)
        for step in range(round(CLOSING_TIME / self.settings.time_step)):
            self._step()
            if step % 20 == 19 and self._shift(T_start) > MAX_SHIFT_CLOSING:
                break
        T_object_tcp = inverse(body_pose(self.client, self.object)) @ T_world_tcp
        joints = self.controller.state()[0]
        fingers, _, depth = self.controller.contacts(self.object)
        touching = 0 in fingers and len(fingers) >= 2 and self._shift(T_start) <= MAX_SHIFT_CLOSING
        return touching, TrialResult(False, "closing", joints, T_object_tcp, depth)

    def _shake(self, closed: TrialResult, rotation: Array) -> TrialResult:
        """The six-axis test on a hand that has closed, with axes `rotation` (3, 3)."""
        T_closed = body_pose(self.client, self.object)
        depth = closed.penetration
        for axis in AXES:
            self._gravity(rotation @ axis * self.settings.gravity)
            for step in range(GRAVITY_STEPS):
                self._step()
                if step % 25 == 24 and self._shift(T_closed) > MAX_SHIFT_GRAVITY:
                    return replace(closed, stage="gravity", penetration=depth)
            fingers, _, deeper = self.controller.contacts(self.object)
            depth = max(depth, deeper)
            if len(fingers) < 2:
                return replace(closed, stage="gravity", penetration=depth)
        return replace(closed, stable=True, stage="stable", penetration=depth)

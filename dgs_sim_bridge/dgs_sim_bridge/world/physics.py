"""PyBullet building blocks shared by the tabletop world and the grasp synthesis.

Settings, objects from convex parts, the hand's joint motors.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial import ConvexHull

from dgs_description.frames import Array, from_quaternion, to_quaternion
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_sim_bridge.render.object_model import ObjectModel


@dataclass(frozen=True)
class PhysicsSettings:
    """Numbers of the contact simulation; each was chosen by a paired trial (docs/grasp_synthesis.md)."""

    time_step: float = 1.0 / 240.0
    hand_friction: float = 0.8
    """Bullet multiplies the coefficients of the two bodies."""
    table_friction: float = 0.8
    spinning_friction: float = 0.005
    rolling_friction: float = 0.0005
    finger_inertia: float = 1e-4
    """Reflected rotor inertia on every finger link [kg m^2].

    Halves penetration and doubles the share of stable grasps.
    """
    object_damping: float = 0.04
    gravity: float = 9.81

    def friction(self, lateral: float) -> dict[str, float]:
        """Of a link with a lateral coefficient, as PyBullet's `changeDynamics` takes it."""
        spinning, rolling = self.spinning_friction, self.rolling_friction
        return {"lateralFriction": lateral, "spinningFriction": spinning, "rollingFriction": rolling}


PHYSICS = PhysicsSettings()
HAND_GAINS = (0.3, 1.0)
"""Shares of the position and of the velocity error that a motor of the hand removes per time step."""


class _Quiet(BulletClient):
    """A headless client; those of the base class print a line each, for the options that they pass."""

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._client = pybullet.connect(pybullet.DIRECT)


def new_world() -> BulletClient:
    """A fresh headless PyBullet world: call PyBullet's functions on it. It ends with its last user."""
    bullet = _Quiet()
    bullet.setPhysicsEngineParameter(
        fixedTimeStep=PHYSICS.time_step,
        numSolverIterations=30,
        numSubSteps=0,
        erp=0.2,
        contactERP=0.4,
        globalCFM=0.0,
        deterministicOverlappingPairs=1,
    )
    return bullet


@cache
def _scratch() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="dgs_parts_")


def forget_shapes() -> None:
    """Remove the files that `collision_shape` has written: a process that leaves by `os._exit` has to ask for it."""
    _scratch.cache_clear()


def collision_shape(bullet: BulletClient, parts: Sequence[NDArray]) -> int:
    """Compound collision shape of convex parts, each (V, 3) [m]."""
    if len(parts) == 1:
        return bullet.createCollisionShape(pybullet.GEOM_MESH, vertices=np.asarray(parts[0], float).tolist())
    # PyBullet builds a compound of hulls only from a file: one OBJ group per part.
    key = abs(hash(tuple(np.ascontiguousarray(part, dtype=np.float32).tobytes() for part in parts)))
    path = Path(_scratch().name) / f"{key:016x}.obj"
    if not path.exists():
        lines, first = [], 1
        for k, part in enumerate(parts):
            lines.append(f"o hull_{k:03d}")
            lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in part]
            faces = ConvexHull(np.asarray(part, dtype=np.float64)).simplices + first
            lines += [f"f {a} {b} {c}" for a, b, c in faces]
            first += len(part)
        path.write_text("\n".join(lines) + "\n")
    return bullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path))


def add_object(
    bullet: BulletClient, model: ObjectModel, T_world_object: Array, settings: PhysicsSettings = PHYSICS
) -> int:
    """Put an object into the world.

    Args:
        T_world_object: (4, 4) pose.

    Returns:
        The body's id.
    """
    position, quaternion = to_quaternion(T_world_object)
    shape = collision_shape(bullet, model.parts)
    body = bullet.createMultiBody(model.mass, shape, -1, position.tolist(), quaternion.tolist())
    damping = {"linearDamping": settings.object_damping, "angularDamping": settings.object_damping}
    bullet.changeDynamics(body, -1, **settings.friction(model.friction), **damping)
    return int(body)


def change_links(bullet: BulletClient, body: int, **dynamics: float) -> None:
    """PyBullet's `changeDynamics` for every link of a body."""
    for link in range(-1, bullet.getNumJoints(body)):
        bullet.changeDynamics(body, link, **dynamics)


def body_pose(bullet: BulletClient, body: int) -> Array:
    """(4, 4) pose of a body's base in the world."""
    return from_quaternion(*bullet.getBasePositionAndOrientation(body))


def set_body_pose(bullet: BulletClient, body: int, T_world_body: Array) -> None:
    """Place a body at rest."""
    bullet.resetBasePositionAndOrientation(body, *(values.tolist() for values in to_quaternion(T_world_body)))
    bullet.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0))


class JointMotors:
    """Position motors of some joints of a body, limited in torque."""

    def __init__(
        self,
        bullet: BulletClient,
        body: int,
        names: Sequence[str],
        efforts: ArrayLike,
        gains: tuple[float, float],
        **dynamics: object,
    ) -> None:
        """Take the motors over.

        Args:
            bullet: PyBullet world.
            body: body with the joints.
            names: N joints, the order of all arrays.
            efforts: (N,) torque limits [Nm].
            gains: shares of the position and of the velocity error that a motor removes per time step.
            dynamics: of the joints' links, as for PyBullet's `changeDynamics`; the joints have no damping.
        """
        self._bullet, self._body, self._efforts = bullet, body, np.asarray(efforts, float)
        count = len(names)
        self._gains = {"positionGains": [gains[0]] * count, "velocityGains": [gains[1]] * count}
        self._still = [0.0] * count
        index = {bullet.getJointInfo(body, k)[1].decode(): k for k in range(bullet.getNumJoints(body))}
        self._joints = [index[name] for name in names]
        undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}
        for joint in self._joints:
            bullet.changeDynamics(body, joint, **undamped, **dynamics)

    def reset(self, positions: ArrayLike) -> None:
        """Set the joints (N,) [rad] at once, at rest: for the start of a world or trial only."""
        values = np.asarray(positions, float).reshape(len(self._joints))
        states = [[value] for value in values], [[0.0]] * len(values)
        self._bullet.resetJointStatesMultiDof(self._body, self._joints, *states)
        self.command(values)

    def command(
        self, positions: ArrayLike, velocities: ArrayLike | None = None, force_scale: ArrayLike = 1.0
    ) -> None:
        """Set points: (N,) positions [rad], (N,) velocities [rad/s]; `force_scale` (N,) scales the torque limits."""
        self._bullet.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=np.asarray(positions, float).tolist(),
            targetVelocities=self._still if velocities is None else np.asarray(velocities, float).tolist(),
            forces=(self._efforts * force_scale).tolist(),
            **self._gains,
        )

    def state(self) -> tuple[Array, Array, Array]:
        """Measured (N,) positions [rad], velocities [rad/s] and motor torques of the last step [Nm]."""
        states = self._bullet.getJointStates(self._body, self._joints)
        positions, velocities, _, torques = zip(*states, strict=True)
        return np.array(positions), np.array(velocities), np.array(torques)


class HandController(JointMotors):
    """The motors of the hand's joints, and what its links touch."""

    def __init__(self, bullet: BulletClient, body: int, settings: PhysicsSettings = PHYSICS) -> None:
        """Take the motors over, and give the fingers friction and rotor inertia."""
        dynamics = settings.friction(settings.hand_friction)
        inertia = (settings.finger_inertia,) * 3
        super().__init__(
            bullet, body, HAND.joints, HAND.effort, HAND_GAINS, localInertiaDiagonal=inertia, **dynamics
        )
        self._finger_of_link = {link: k // JOINTS_PER_FINGER for k, link in enumerate(self._joints)}
        self._finger_of_tip = {link: finger for finger, link in enumerate(self._joints[3::JOINTS_PER_FINGER])}

    def contacts(self, other: int) -> set[int]:
        """Fingers, by number, that touch `other`."""
        points = self._bullet.getContactPoints(self._body, other)
        touching = [point for point in points if point[8] < 5e-4]
        return {self._finger_of_link.get(point[3], -1) for point in touching} - {-1}

    def fingertip_forces(self) -> Array:
        """(F, 2) sums of the normal forces on the distal links, and size of the sum of those along them [N]."""
        normal, along = np.zeros(HAND.finger_count), np.zeros((HAND.finger_count, 3))
        for point in self._bullet.getContactPoints(self._body):
            finger = self._finger_of_tip.get(point[3])
            if finger is not None:
                normal[finger] += point[9]
                along[finger] += point[10] * np.array(point[11]) + point[12] * np.array(point[13])
        return np.column_stack([normal, np.linalg.norm(along, axis=1)])

"""PyBullet building blocks shared by the tabletop world and the grasp synthesis.

Settings, objects from convex parts, the hand's joint motors.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from dgs_description.frames import from_quaternion, to_quaternion
from dgs_description.joints import FINGERS, HAND_EFFORT, HAND_JOINTS
from dgs_hand_driver.admittance import AdmittanceController
from dgs_sim_bridge.render.object_model import ObjectModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PhysicsSettings:
    """Numbers of the contact simulation; each was chosen by a paired trial (docs/grasp_synthesis.md)."""

    time_step: float = 1.0 / 240.0
    solver_iterations: int = 30
    erp: float = 0.2
    contact_erp: float = 0.4
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
    position_gain: float = 0.3
    velocity_gain: float = 1.0
    gravity: float = 9.81


PHYSICS = PhysicsSettings()


def new_client(settings: PhysicsSettings = PHYSICS) -> int:
    """A fresh headless PyBullet world; pass the returned id to every call (without it calls go to client 0)."""
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setPhysicsEngineParameter(
        fixedTimeStep=settings.time_step,
        numSolverIterations=settings.solver_iterations,
        numSubSteps=0,
        erp=settings.erp,
        contactERP=settings.contact_erp,
        globalCFM=0.0,
        deterministicOverlappingPairs=1,
        physicsClientId=client,
    )
    return client


@cache
def _scratch() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="dgs_parts_")


def collision_shape(client: int, parts: Sequence[NDArray]) -> int:
    """Compound collision shape of convex parts, each (V, 3) [m]."""
    if len(parts) == 1:
        return pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=np.asarray(parts[0], float).tolist(), physicsClientId=client
        )
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
    return pybullet.createCollisionShape(pybullet.GEOM_MESH, fileName=str(path), physicsClientId=client)


def add_object(
    client: int, model: ObjectModel, T_world_object: Array, settings: PhysicsSettings = PHYSICS
) -> int:
    """Put an object into the world.

    Args:
        T_world_object: (4, 4) pose.

    Returns:
        The body's id.
    """
    position, quaternion = to_quaternion(T_world_object)
    body = pybullet.createMultiBody(
        baseMass=model.mass,
        baseCollisionShapeIndex=collision_shape(client, model.parts),
        basePosition=position.tolist(),
        baseOrientation=quaternion.tolist(),
        physicsClientId=client,
    )
    pybullet.changeDynamics(
        body,
        -1,
        lateralFriction=model.friction,
        spinningFriction=settings.spinning_friction,
        rollingFriction=settings.rolling_friction,
        linearDamping=settings.object_damping,
        angularDamping=settings.object_damping,
        physicsClientId=client,
    )
    return body


def body_pose(client: int, body: int) -> Array:
    """(4, 4) pose of a body's base in the world."""
    return from_quaternion(*pybullet.getBasePositionAndOrientation(body, physicsClientId=client))


def set_body_pose(client: int, body: int, T_world_body: Array) -> None:
    """Place a body at rest."""
    position, quaternion = to_quaternion(T_world_body)
    pybullet.resetBasePositionAndOrientation(
        body, position.tolist(), quaternion.tolist(), physicsClientId=client
    )
    pybullet.resetBaseVelocity(body, (0, 0, 0), (0, 0, 0), physicsClientId=client)


def joint_indices(client: int, body: int) -> dict[str, int]:
    """Joint index by name."""
    count = pybullet.getNumJoints(body, physicsClientId=client)
    return {pybullet.getJointInfo(body, i, physicsClientId=client)[1].decode(): i for i in range(count)}


@dataclass
class HandController:
    """The hand's joint motors with their torque limits, driven in position or through the admittance controller.

    Attributes:
        client: PyBullet world.
        body: body that carries the 20 hand joints.
    """

    client: int
    body: int
    settings: PhysicsSettings = PHYSICS
    admittance: AdmittanceController = field(default_factory=AdmittanceController)

    def __post_init__(self) -> None:
        index = joint_indices(self.client, self.body)
        self.joints = [index[name] for name in HAND_JOINTS]
        self.link_finger = {
            index[f"{finger}_joint{k}"]: f for f, finger in enumerate(FINGERS) for k in (1, 2, 3, 4)
        }
        """Finger number by link index."""
        self._gains = [self.settings.position_gain] * 20, [self.settings.velocity_gain] * 20
        self._forces = HAND_EFFORT.tolist()
        for link in self.joints:
            pybullet.changeDynamics(
                self.body,
                link,
                lateralFriction=self.settings.hand_friction,
                spinningFriction=self.settings.spinning_friction,
                rollingFriction=self.settings.rolling_friction,
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
                localInertiaDiagonal=(self.settings.finger_inertia,) * 3,
                physicsClientId=self.client,
            )

    def reset(self, joints: ArrayLike) -> None:
        """Set the joints at once, at rest: for the start of a trial only."""
        values = np.asarray(joints, float).reshape(20)
        pybullet.resetJointStatesMultiDof(
            self.body, self.joints, [[v] for v in values], [[0.0]] * 20, physicsClientId=self.client
        )
        self.command(values)

    def state(self) -> tuple[Array, Array]:
        """(20,) measured joints [rad] and (20,) motor torques of the last step [Nm]."""
        states = pybullet.getJointStates(self.body, self.joints, physicsClientId=self.client)
        return np.array([s[0] for s in states]), np.array([s[3] for s in states])

    def command(self, joints: ArrayLike, force_scale: ArrayLike | None = None) -> None:
        """Position command (20,) [rad] to the motors, torque limited; `force_scale` (20,) scales the limits."""
        pybullet.setJointMotorControlArray(
            self.body,
            self.joints,
            pybullet.POSITION_CONTROL,
            targetPositions=np.asarray(joints, float).reshape(20).tolist(),
            positionGains=self._gains[0],
            velocityGains=self._gains[1],
            forces=self._forces if force_scale is None else (HAND_EFFORT * np.asarray(force_scale)).tolist(),
            physicsClientId=self.client,
        )

    def start_closing(self, target: ArrayLike, active: ArrayLike, max_speed: float) -> None:
        """Begin an admittance-controlled move from the measured joints (see `AdmittanceController.start`)."""
        self.admittance.start(self.state()[0], target, active, max_speed)

    def step_admittance(self) -> None:
        """One control period of the admittance: the surroundings' torque is minus the motor's."""
        states = pybullet.getJointStates(self.body, self.joints, physicsClientId=self.client)
        resistance = np.array([-state[3] for state in states])
        self.command(self.admittance.step(resistance, self.settings.time_step))

    def contacts(self, other: int) -> tuple[set[int], bool, float]:
        """Fingers (0..4) that touch `other`, whether the palm does, and the deepest reported penetration
        [m]."""
        fingers: set[int] = set()
        palm, depth = False, 0.0
        for point in pybullet.getContactPoints(self.body, other, physicsClientId=self.client):
            if point[8] < 5e-4:
                finger = self.link_finger.get(point[3])
                if finger is None:
                    palm = True
                else:
                    fingers.add(finger)
                depth = max(depth, -point[8])
        return fingers, palm, depth

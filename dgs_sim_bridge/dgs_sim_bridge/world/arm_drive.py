"""The simulated arm's six joint motors: stiff position control within the UR3's torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray

from dgs_description.joints import ARM_EFFORT, ARM_JOINTS
from dgs_sim_bridge.world.physics import joint_indices

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmState:
    """Measured joints in the order of `ARM_JOINTS`: (6,) positions [rad], velocities [rad/s], motor torques [Nm]."""

    positions: Array
    velocities: Array
    efforts: Array


class ArmDrive:
    """Position motors of the arm joints of a body."""

    def __init__(
        self, client: int, body: int, position_gain: float = 0.6, velocity_gain: float = 1.0
    ) -> None:
        """Take the motors over; they hold the joints where they are.

        Args:
            client: PyBullet world.
            body: body with the six arm joints.
            position_gain: share of the position error that a motor removes per time step.
            velocity_gain: the same for the velocity error.
        """
        self._client, self._body = client, body
        self._gains = [position_gain] * 6, [velocity_gain] * 6
        index = joint_indices(client, body)
        self._joints = [index[name] for name in ARM_JOINTS]
        for joint in self._joints:
            pybullet.changeDynamics(
                body, joint, linearDamping=0, angularDamping=0, jointDamping=0, physicsClientId=client
            )
        self.command(self.state().positions, np.zeros(6))

    def reset(self, positions: ArrayLike) -> None:
        """Set the joints at once, at rest: for the start of a world only."""
        values = np.asarray(positions, float).reshape(6)
        pybullet.resetJointStatesMultiDof(
            self._body, self._joints, [[v] for v in values], [[0.0]] * 6, physicsClientId=self._client
        )
        self.command(values, np.zeros(6))

    def command(self, positions: ArrayLike, velocities: ArrayLike) -> None:
        """Set points of all joints: (6,) positions [rad] and velocities [rad/s]."""
        pybullet.setJointMotorControlArray(
            self._body,
            self._joints,
            pybullet.POSITION_CONTROL,
            targetPositions=np.asarray(positions, float).tolist(),
            targetVelocities=np.asarray(velocities, float).tolist(),
            positionGains=self._gains[0],
            velocityGains=self._gains[1],
            forces=ARM_EFFORT.tolist(),
            physicsClientId=self._client,
        )

    def state(self) -> ArmState:
        """What the joints' sensors say."""
        states = pybullet.getJointStates(self._body, self._joints, physicsClientId=self._client)
        columns = np.array([(s[0], s[1], s[3]) for s in states])
        return ArmState(columns[:, 0], columns[:, 1], columns[:, 2])

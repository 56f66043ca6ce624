"""Admittance control of the hand's joints: closes until contact. Shared by hand, simulator and grasp synthesis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.joints import HAND_LOWER, HAND_SPEED, HAND_UPPER
from dgs_description.pick import CLOSING_MARGIN

Array = NDArray[np.float64]

# Virtual spring and damper, found by paired trials of the grasp synthesis (docs/grasp_synthesis.md).
STIFFNESS = np.array([5.0, 5.0, 2.5, 2.5])
"""Of yaw, pitch, middle, distal [Nm/rad]."""
THUMB_FACTOR = 2.0
"""The thumb works against four fingers and is stiffer by this factor."""
TIME_CONSTANT = 0.08
"""Damping over stiffness [s]."""
IDLE_STIFFNESS = 50.0
"""Of fingers that take no part in the grasp [Nm/rad]."""


class AdmittanceController:
    """Overdamped virtual spring and damper: D x' = K (x_d - x) + tau_ext, one state per active joint.

    The mass of the paper's mass-damper-spring model is left out: with D = K * 0.08 s it only adds a lag below the
    sampling time. theta3 and theta4 share one state (their torques are summed), so the coupling holds exactly in the
    command. The desired position x_d itself walks to the target at a limited speed.

    Attributes:
        position: (20,) commanded joints x [rad].
        desired: (20,) walking set point x_d [rad].
    """

    def __init__(self) -> None:
        """At rest with all joints at zero."""
        self.start(np.zeros(20), np.zeros(20), np.ones(5), HAND_SPEED)

    def start(self, position: ArrayLike, target: ArrayLike, active: ArrayLike, max_speed: float) -> None:
        """Begin a move.

        Args:
            position: (20,) measured joints [rad].
            target: (20,) joints to close to, margin included [rad].
            active: (5,) bool, fingers that comply; the others hold their way to the target stiffly.
            max_speed: limit of x_d' and x' [rad/s].
        """
        self.position = np.array(position, dtype=np.float64).reshape(20)
        self.desired = self.position.copy()
        self._target = np.clip(np.asarray(target, dtype=np.float64).reshape(20), HAND_LOWER, HAND_UPPER)
        self._max_speed = float(max_speed)
        self._idle = np.flatnonzero(~np.asarray(active, dtype=bool).reshape(5))
        self._stiffness = np.tile(STIFFNESS, (5, 1))
        self._stiffness[0] *= THUMB_FACTOR
        self._stiffness[self._idle] = IDLE_STIFFNESS
        self._damping = self._stiffness * TIME_CONSTANT
        self._damping[:, 2:] = self._damping[:, 2:].sum(1, keepdims=True)

    def step(self, external_torque: ArrayLike, dt: float) -> Array:
        """Advance by one control period.

        Args:
            external_torque: (20,) torque of the surroundings on the joints, positive in closing direction [Nm].
            dt: control period [s].

        Returns:
            (20,) joint command [rad].
        """
        # minimum and maximum instead of clip, which costs three times as much: this runs at every step of a simulation.
        reach = self._max_speed * dt
        self.desired += np.minimum(np.maximum(self._target - self.desired, -reach), reach)
        force = self._stiffness * (self.desired - self.position).reshape(5, 4)
        force += np.asarray(external_torque, dtype=np.float64).reshape(5, 4)
        force[:, 2:] = force[:, 2:3] + force[:, 3:]
        speed = np.minimum(np.maximum(force / self._damping, -self._max_speed), self._max_speed)
        position = self.position.reshape(5, 4) + speed * dt
        if len(self._idle):
            position[self._idle] = self.desired.reshape(5, 4)[self._idle]
        self.position = np.minimum(np.maximum(position.reshape(20), HAND_LOWER), HAND_UPPER)
        return self.position


def closing_target(grasp_joints: ArrayLike, active: ArrayLike, margin: ArrayLike = CLOSING_MARGIN) -> Array:
    """(20,) closing target of a final grasp: J_end plus the margin on the active fingers, within limits [rad].

    Args:
        grasp_joints: (20,) J_end [rad].
        active: (5,) bool.
        margin: of yaw, pitch, and middle with distal [rad].
    """
    yaw, pitch, middle = np.asarray(margin, dtype=np.float64)
    joints = np.array(grasp_joints, dtype=np.float64).reshape(5, 4)
    joints[np.asarray(active, dtype=bool)] += (yaw, pitch, middle, middle)
    return np.clip(joints.reshape(20), HAND_LOWER, HAND_UPPER)


def active_fingers(
    pre_grasp_joints: ArrayLike, grasp_joints: ArrayLike, threshold: float = 0.05
) -> NDArray[np.bool_]:
    """(5,) fingers that take part: their flexion changes by more than `threshold` [rad] between the two shapes."""
    change = np.abs(np.asarray(grasp_joints, float) - np.asarray(pre_grasp_joints, float)).reshape(5, 4)
    return change[:, 1:3].max(1) > threshold

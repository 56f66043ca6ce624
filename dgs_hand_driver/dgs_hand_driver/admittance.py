"""Admittance control of the hand's joints: closes until contact. Shared by hand, simulator and grasp synthesis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import Array
from dgs_description.hand_model import end_ball_jacobian, end_balls
from dgs_description.joints import HAND_EFFORT, HAND_LOWER, HAND_SPEED, HAND_UPPER
from dgs_description.pick import CLOSING_MARGIN, closing_limit

# Virtual spring and damper, found by paired trials of the grasp synthesis (docs/grasp_synthesis.md).
STIFFNESS = np.array([5.0, 5.0, 2.5, 2.5])
"""Of yaw, pitch, middle, distal [Nm/rad]."""
THUMB_FACTOR = 2.0
"""The thumb works against four fingers and is stiffer by this factor."""
TIME_CONSTANT = 0.08
"""Damping over stiffness [s]."""
SQUEEZE_EFFORT, SQUEEZE_FORCE = 0.95, 16.0
"""The squeeze takes this share of the most loaded joint's torque, and at most so much force between thumb and fingers
[N]: the data sheet rates a fingertip at 10 N."""
PRESS = 0.08
"""So much at most a finger that was stopped before J_end presses on towards it at first [rad]."""
BALANCING_TIME, BALANCING_RATE = 0.6, 10.0
"""How long after the last contact [s], and how fast [1/s], the springs are set anew to `squeeze_torques`."""
CONTACT_TORQUE = 0.1
"""Less against its pitch, or its middle and distal joint, and a finger has met nothing [Nm]."""
ARRIVED = 0.02
"""Nearer than this to its target a finger has got there [rad]."""
FEELING_TIME = 0.2
"""In which a finger that has met nothing goes on by the whole closing margin [s]."""
IDLE_STIFFNESS = 50.0
"""Of fingers that take no part in the grasp [Nm/rad]."""


def squeeze_torques(grasp_joints: ArrayLike, active: ArrayLike) -> Array:
    """(5, 3) torques of yaw, pitch and the coupled pair that press the end balls of thumb and fingers together [Nm].

    Every active finger pushes towards the thumb with an equal share of the force, the thumb against their sum:
    tau = J^T f. All lines of force meet in the thumb's ball, so forces and moments on what is between are in balance,
    and it stays where it is. Zero where thumb or fingers take no part.

    Args:
        grasp_joints: (20,) posture of the hand [rad].
        active: (5,) bool.
    """
    joints = np.asarray(grasp_joints, dtype=np.float64).reshape(5, 4)
    fingers = np.flatnonzero(np.asarray(active, dtype=bool)[1:]) + 1
    if not len(fingers) or not np.asarray(active)[0]:
        return np.zeros((5, 3))
    balls = end_balls(joints)
    towards = balls[0] - balls[fingers]
    force = np.zeros((5, 3))
    force[fingers] = towards / np.linalg.norm(towards, axis=1, keepdims=True) / len(fingers)
    force[0] = -force.sum(axis=0)
    torques = np.einsum("fik,fi->fk", end_ball_jacobian(joints), force)
    limits = HAND_EFFORT.reshape(5, 4)[:, :3] * (1.0, 1.0, 2.0)
    scale = min(SQUEEZE_EFFORT / (np.abs(torques) / limits).max(), SQUEEZE_FORCE)
    return np.asarray(torques * scale)


class AdmittanceController:
    """Overdamped virtual spring and damper: D x' = K (x_d - x) + tau_ext, one state per active joint.

    The mass of the paper's mass-damper-spring model is left out: with D = K * 0.08 s it only adds a lag below the
    sampling time. theta3 and theta4 share one state (their torques are summed), so the coupling holds exactly in the
    command. The set point x_d walks at a limited speed to the final joints and past them by what the spring needs for
    `squeeze_torques`. A finger that has met nothing there feels on, up to `closing_limit`. When no finger feels any
    more, the set points follow the fingers for `BALANCING_TIME`: what is left of the way to J_end, of fingers that
    were stopped before it, relaxes, and forces remain that hold each other. Else a thumb that slides up on what it
    presses onto a table jams, and lets go when it is lifted.

    Attributes:
        position: (20,) commanded joints x [rad].
        desired: (20,) walking set point x_d [rad].
    """

    def __init__(self) -> None:
        """At rest with all joints at zero."""
        self.start(np.zeros(20), np.zeros(20), np.zeros(5), HAND_SPEED)

    def start(
        self, position: ArrayLike, grasp_joints: ArrayLike, active: ArrayLike, max_speed: float
    ) -> None:
        """Begin to close.

        Args:
            position: (20,) measured joints [rad].
            grasp_joints: (20,) J_end, where the fingers are to touch [rad].
            active: (5,) bool, fingers that comply; the others hold their way to J_end stiffly.
            max_speed: limit of x_d' and x' [rad/s].
        """
        self.position = np.array(position, dtype=np.float64).reshape(20)
        self.desired = self.position.copy()
        self._max_speed = float(max_speed)
        self._feeling = np.asarray(active, dtype=bool).reshape(5).copy()
        self._idle = np.flatnonzero(~self._feeling)
        self._stiffness = np.tile(STIFFNESS, (5, 1))
        self._stiffness[0] *= THUMB_FACTOR
        self._stiffness[self._idle] = IDLE_STIFFNESS
        self._damping = self._stiffness * TIME_CONSTANT
        self._damping[:, 2:] = self._damping[:, 2:].sum(1, keepdims=True)
        self._springs = np.column_stack([self._stiffness[:, :2], self._stiffness[:, 2:].sum(axis=1)])
        joints = np.asarray(grasp_joints, dtype=np.float64).reshape(20)
        self._target = self._squeezing(joints, self._feeling)
        self._limit = np.maximum(closing_limit(joints, active), self._target)
        self._touching = np.zeros(5, dtype=bool)
        self._balancing = BALANCING_TIME

    def _squeezing(self, joints: Array, fingers: NDArray[np.bool_]) -> Array:
        """(20,) set point that squeezes with `fingers` (5,) in the posture `joints` (20,)."""
        offset = (squeeze_torques(joints, fingers) / self._springs)[:, [0, 1, 2, 2]]
        return np.clip(joints + offset.reshape(20), HAND_LOWER, HAND_UPPER)

    def step(self, external_torque: ArrayLike, dt: float) -> Array:
        """Advance by one control period.

        Args:
            external_torque: (20,) torque of the surroundings on the joints, positive in closing direction [Nm].
            dt: control period [s].

        Returns:
            (20,) joint command [rad].
        """
        # minimum and maximum instead of clip, which costs three times as much: this runs at every step of a simulation.
        reach, before = self._max_speed * dt, self.position.copy()
        self.desired += np.minimum(np.maximum(self._target - self.desired, -reach), reach)
        torque = np.asarray(external_torque, dtype=np.float64).reshape(5, 4)
        if self._feeling.any():
            self._feel(torque, dt)
        elif self._balancing > 0:
            self._balance(dt)
        force = self._stiffness * (self.desired - self.position).reshape(5, 4)
        force += torque
        force[:, 2:] = force[:, 2:3] + force[:, 3:]
        speed = np.minimum(np.maximum(force / self._damping, -self._max_speed), self._max_speed)
        position = self.position.reshape(5, 4) + speed * dt
        if len(self._idle):
            position[self._idle] = self.desired.reshape(5, 4)[self._idle]
        position = np.minimum(np.maximum(position.reshape(20), before - reach), before + reach)
        self.position = np.minimum(np.maximum(position, HAND_LOWER), HAND_UPPER)
        return self.position

    def _feel(self, torque: Array, dt: float) -> None:
        """Move fingers on that have got to their target and met nothing; in the end, squeeze with those that touch."""
        ways = np.abs([self._target - self.desired, self._target - self.position]).reshape(2, 5, 4).max(-1)
        there = self._feeling & (ways[0] < 1e-9)
        touching = np.minimum(torque[:, 1], torque[:, 2] + torque[:, 3]) < -CONTACT_TORQUE
        self._touching |= there & touching
        yaw, pitch, middle = CLOSING_MARGIN
        way = np.array([yaw, pitch, middle, middle]) * min(dt / FEELING_TIME, 1.0)
        target = self._target.reshape(5, 4)
        way = np.minimum(target + way, self._limit.reshape(5, 4)) - target
        ended = np.abs(way).max(axis=1) < 1e-9
        going = there & ~self._touching & (ways[1] < ARRIVED)
        self._feeling &= ~(self._touching | (going & ended))
        moved = np.where((going & self._feeling)[:, None], way, 0.0).reshape(20)
        for values in (self._target, self.desired, self.position):
            values += moved
        if not self._feeling.any() and self._holding():
            squeezing = self._squeezing(self.position, self._touching)
            squeezing = np.maximum(squeezing, np.minimum(self._target, self.position + PRESS))
            self._target = np.where(np.repeat(self._touching, 4), squeezing, self._target)

    def _balance(self, dt: float) -> None:
        """Let the set points of the fingers that touch follow them, ahead by what the squeeze needs."""
        self._balancing -= dt
        if self._holding():
            way = self._squeezing(self.position, self._touching) - self._target
            self._target += np.where(np.repeat(self._touching, 4), way * min(BALANCING_RATE * dt, 1.0), 0.0)

    def _holding(self) -> bool:
        return bool(self._touching[0] and self._touching[1:].any())


def active_fingers(
    pre_grasp_joints: ArrayLike, grasp_joints: ArrayLike, threshold: float = 0.05
) -> NDArray[np.bool_]:
    """(5,) fingers that take part: their flexion changes by more than `threshold` [rad] between the two shapes."""
    change = np.abs(np.asarray(grasp_joints, float) - np.asarray(pre_grasp_joints, float)).reshape(5, 4)
    return change[:, 1:3].max(1) > threshold

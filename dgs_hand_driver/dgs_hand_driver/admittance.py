"""Admittance control of the hand's joints: closes until contact. Shared by hand, simulator and grasp synthesis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_description.pick import closing_limit

_PAIRS = HAND.coupled[:, None]
# Virtual spring and damper, found by paired trials of the grasp synthesis (docs/grasp_synthesis.md).
TIME_CONSTANT = 0.08
"""Damping over stiffness [s]."""
SQUEEZE_EFFORT, SQUEEZE_FORCE = 0.95, 16.0
"""The squeeze takes this share of the most loaded joint's torque, and at most so much force between thumb and fingers
[N]: the data sheet rates a fingertip at 10 N."""
PRESS = 0.08
"""So much at most a finger that was stopped before J_end presses on towards it at first [rad]."""
BALANCING_TIME, BALANCING_RATE = 0.6, 10.0
"""How long after the last contact [s], and how fast [1/s], the springs are set anew to `squeeze_torques`."""
HOLDING_RATE, HOLDING_PERIOD = 0.5, 0.1
"""How fast [1/s], and how often [s], the same goes on as long as something is held: what is carried creeps, and
fixed springs end in a squeeze that nobody chose (docs/grasp_synthesis.md)."""
CONTACT_TORQUE = 0.1
"""Less against its pitch, or its middle and distal joint, and a finger has met nothing [Nm]."""
CONTACT_DAMPING, PRESSING = 10.0, 0.5
"""Times the damping of a finger that feels this torque [Nm], less below: one that grazes the table goes on.

Torques are felt late, over a bus or through slow electronics: where a motor's position loop holds k [Nm/rad] and the
damping is D, it swings from a delay of pi / 2 D / k on, which is 10 ms in the trial worlds without this, and 100 ms
with it."""
ARRIVED = 0.02
"""Nearer than this to its target a finger has got there [rad]."""
FEELING_TIME = 0.2
"""In which a finger that has met nothing goes on up to `closing_limit` [s]."""
IDLE_STIFFNESS = 50.0
"""Of fingers that take no part in the grasp [Nm/rad]."""


def squeeze_torques(grasp_joints: ArrayLike, active: ArrayLike) -> Array:
    """(F, 4) torques that press the end balls of thumb and fingers together, a pair's at its middle joint [Nm].

    Every active finger pushes towards the thumb with an equal share of the force, the thumb against their sum:
    tau = J^T f. All lines of force meet in the thumb's ball, so forces and moments on what is between are in balance,
    and it stays where it is. Zero where thumb or fingers take no part.

    Args:
        grasp_joints: (J,) posture of the hand [rad].
        active: (F,) bool.
    """
    joints = HAND.split(np.asarray(grasp_joints, dtype=np.float64))
    fingers = np.flatnonzero(np.asarray(active, dtype=bool)[1:]) + 1
    if not len(fingers) or not np.asarray(active)[0]:
        return np.zeros((HAND.finger_count, JOINTS_PER_FINGER))
    balls, jacobian = HAND.end_ball_jacobian(joints)
    towards = balls[0] - balls[fingers]
    force = np.zeros((HAND.finger_count, 3))
    force[fingers] = towards / np.linalg.norm(towards, axis=1, keepdims=True) / len(fingers)
    force[0] = -force.sum(axis=0)
    torques = _paired(np.einsum("fik,fi->fk", jacobian, force))
    limits = _paired(HAND.split(HAND.effort))
    torques[limits == 0.0], limits[limits == 0.0] = 0.0, 1.0
    scale = min(SQUEEZE_EFFORT / (np.abs(torques) / limits).max(), SQUEEZE_FORCE)
    return np.asarray(torques * scale)


def _paired(torques: Array) -> Array:
    """(F, 4) torques of all joints -> the same with those of coupled pairs summed at the middle joint [Nm]."""
    summed = torques.copy()
    summed[HAND.coupled, 2] += torques[HAND.coupled, 3]
    summed[HAND.coupled, 3] = 0.0
    return summed


class AdmittanceController:
    """One closing by overdamped virtual springs: D x' = K (x_d - x) + tau_ext, one state per active joint.

    The mass of the paper's mass-damper-spring model is left out: with D = K * 0.08 s it only adds a lag below the
    sampling time. theta3 and theta4 share one state (their torques are summed), so the coupling holds exactly in the
    command. The set point x_d walks at a limited speed to the final joints and past them by what the spring needs for
    `squeeze_torques`. A finger that has met nothing there feels on, up to `closing_limit`. When no finger feels any
    more, the set points follow the fingers for `BALANCING_TIME`: what is left of the way to J_end, of fingers that
    were stopped before it, relaxes, and forces remain that hold each other. Else a thumb that slides up on what it
    presses onto a table jams, and lets go when it is lifted. From then on they follow slowly while thumb and a finger
    feel something; where nothing is felt any more they stand.

    Attributes:
        position: (J,) commanded joints x [rad].
        desired: (J,) walking set point x_d [rad].
    """

    def __init__(
        self, position: ArrayLike, grasp_joints: ArrayLike, active: ArrayLike, max_speed: float
    ) -> None:
        """Begin to close.

        Args:
            position: (J,) measured joints [rad].
            grasp_joints: (J,) J_end, where the fingers are to touch [rad].
            active: (F,) bool, fingers that comply; the others hold their way to J_end stiffly.
            max_speed: limit of x_d' and x' [rad/s].
        """
        self.position = np.array(position, dtype=np.float64).reshape(HAND.joint_count)
        self.desired = self.position.copy()
        self._max_speed = float(max_speed)
        self._feeling = np.asarray(active, dtype=bool).reshape(HAND.finger_count).copy()
        self._idle = np.flatnonzero(~self._feeling)
        self._stiffness = np.tile(HAND.grasp.stiffness, (HAND.finger_count, 1))
        self._stiffness[0] *= HAND.grasp.thumb_factor
        self._stiffness[self._idle] = IDLE_STIFFNESS
        self._damping = self._stiffness * TIME_CONSTANT
        self._damping[:, 2:] = np.where(
            _PAIRS, self._damping[:, 2:].sum(1, keepdims=True), self._damping[:, 2:]
        )
        self._springs = _paired(self._stiffness)
        self._springs[HAND.coupled, 3] = 1.0
        joints = np.asarray(grasp_joints, dtype=np.float64).reshape(HAND.joint_count)
        self._target = self._squeezing(joints, self._feeling)
        self._limit = np.maximum(closing_limit(joints, active), self._target)
        self._final = HAND.split(joints)
        closes = (self._final - HAND.split(self.position))[:, 1:].sum(axis=1, keepdims=True)
        self._past = closes <= 0  # a finger that has to open first would turn round at J_end
        self._touching = np.zeros(HAND.finger_count, dtype=bool)
        self._balancing, self._since = BALANCING_TIME, 0.0

    def _squeezing(self, joints: Array, fingers: NDArray[np.bool_]) -> Array:
        """(J,) set point that squeezes with `fingers` (F,) in the posture `joints` (J,)."""
        offset = squeeze_torques(joints, fingers) / self._springs
        offset[HAND.coupled, 3] = offset[HAND.coupled, 2]
        return np.clip(joints + offset.reshape(HAND.joint_count), HAND.lower, HAND.upper)

    def step(self, external_torque: ArrayLike, dt: float) -> Array:
        """Advance by one control period.

        Args:
            external_torque: (J,) torque of the surroundings on the joints, positive in closing direction [Nm].
            dt: control period [s].

        Returns:
            (J,) joint command [rad].
        """
        # minimum and maximum instead of clip, which costs three times as much: this runs at every step of a simulation.
        reach, before = self._max_speed * dt, self.position.copy()
        # By way of J_end, the joints of a finger all at once: so its ball stays where it was planned to go.
        way = np.where(self._past, HAND.split(self._target), self._final) - HAND.split(self.desired)
        longest = np.abs(way).max(axis=1, keepdims=True)
        self.desired += (way * (reach / np.maximum(longest, reach))).reshape(HAND.joint_count)
        self._past |= longest <= reach
        torque = HAND.split(np.asarray(external_torque, dtype=np.float64))
        if self._feeling.any():
            self._feel(torque, dt)
        else:
            self._balance(torque, dt)
        force = self._stiffness * HAND.split(self.desired - self.position)
        force += torque
        force[:, 2:] = np.where(_PAIRS, force[:, 2:3] + force[:, 3:], force[:, 2:])
        felt = np.minimum(np.abs(torque).max(axis=1, keepdims=True) / PRESSING, 1.0)
        damping = self._damping * (1.0 + (CONTACT_DAMPING - 1.0) * felt)
        speed = np.minimum(np.maximum(force / damping, -self._max_speed), self._max_speed)
        position = HAND.split(self.position) + speed * dt
        if len(self._idle):
            position[self._idle] = HAND.split(self.desired)[self._idle]
        position = np.minimum(np.maximum(position.reshape(HAND.joint_count), before - reach), before + reach)
        self.position = np.minimum(np.maximum(position, HAND.lower), HAND.upper)
        return self.position

    def _feel(self, torque: Array, dt: float) -> None:
        """Move fingers on that have got to their target and met nothing; in the end, squeeze with those that touch."""
        ways = (
            np.abs([self._target - self.desired, self._target - self.position])
            .reshape(2, *HAND.shape)
            .max(-1)
        )
        there = self._feeling & (ways[0] < 1e-9)
        self._touching |= there & _felt(torque)
        way = HAND.beyond * (dt / FEELING_TIME)
        target = HAND.split(self._target)
        way = np.minimum(target + way, HAND.split(self._limit)) - target
        ended = np.abs(way).max(axis=1) < 1e-9
        going = there & ~self._touching & (ways[1] < ARRIVED)
        self._feeling &= ~(self._touching | (going & ended))
        moved = np.where((going & self._feeling)[:, None], way, 0.0).reshape(HAND.joint_count)
        self._target, self.desired, self.position = (
            values + moved for values in (self._target, self.desired, self.position)
        )
        if not self._feeling.any() and _pressed(self._touching):
            squeezing = self._squeezing(self.position, self._touching)
            squeezing = np.maximum(squeezing, np.minimum(self._target, self.position + PRESS))
            self._target = np.where(np.repeat(self._touching, JOINTS_PER_FINGER), squeezing, self._target)

    def _balance(self, torque: Array, dt: float) -> None:
        """Let the set points of the fingers that touch follow them, ahead by what the squeeze needs."""
        self._balancing -= dt
        fingers, share = self._touching, min(BALANCING_RATE * dt, 1.0)
        if self._balancing <= 0:
            self._since += dt
            if self._since < HOLDING_PERIOD:
                return
            fingers, share = fingers & _felt(torque), HOLDING_RATE * self._since
            self._since = 0.0
        if _pressed(fingers):
            way = self._squeezing(self.position, self._touching) - self._target
            self._target += np.where(np.repeat(self._touching, JOINTS_PER_FINGER), way * share, 0.0)


def _felt(torque: Array) -> NDArray[np.bool_]:
    """(F,) fingers that torques (F, 4) of the surroundings keep from closing [Nm]."""
    return np.asarray(np.minimum(torque[:, 1], torque[:, 2] + torque[:, 3]) < -CONTACT_TORQUE)


def _pressed(fingers: NDArray[np.bool_]) -> bool:
    """Whether thumb and a finger are among (F,) fingers."""
    return bool(fingers[0] and fingers[1:].any())


def active_fingers(pre_grasp_joints: ArrayLike, grasp_joints: ArrayLike) -> NDArray[np.bool_]:
    """(F,) fingers that take part: their flexion changes by more than 0.05 rad between the two shapes."""
    change = HAND.split(np.abs(np.asarray(grasp_joints, float) - np.asarray(pre_grasp_joints, float)))
    return np.asarray(change[:, 1:].max(axis=1) > 0.05)

"""All inverse kinematic solutions of the 6R arm: closed form from the DH table, checked with Pinocchio.

For a calibrated robot the closed form gives the seeds of a Newton iteration.
"""

from __future__ import annotations

from functools import cached_property
from itertools import product

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dgs_arm_executor.robot_geometry import load_robot_geometry, model_order
from dgs_description.arm_kinematics import DH_A, DH_ALPHA, DH_D
from dgs_description.arm_model import joint_frames
from dgs_description.frames import TOOL0, Array, inverse
from dgs_description.hand import HAND
from dgs_description.joints import ARM_LOWER, ARM_UPPER

T_TOOL0_TCP = HAND.T_mount_tcp
"""Pose of `hand_tcp` in `tool0`: the hand's mount sits on the flange without a turn."""
T_TCP_TOOL0 = inverse(T_TOOL0_TCP)

BRANCHES = 8
"""Branch index = 4 * shoulder + 2 * wrist + elbow, each 0 or 1."""

_SINGULAR = 1e-7
_TWO_PI = 2 * np.pi


def dh_forward(q: Array) -> Array:
    """Vectorised DH forward kinematics: (..., 6) joints [rad] -> (..., 4, 4) T_base_tool0."""
    out = np.broadcast_to(np.diag([-1.0, -1.0, 1.0, 1.0]), (*q.shape[:-1], 4, 4))
    for i in range(6):
        out = out @ _dh(i, q[..., i])
    return out


def _dh(i: int, theta: Array) -> Array:
    """(..., 4, 4) transform of DH row `i`."""
    ct, st = np.cos(theta), np.sin(theta)
    ca, sa = np.cos(DH_ALPHA[i]), np.sin(DH_ALPHA[i])
    out = np.zeros((*np.shape(theta), 4, 4))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2], out[..., 0, 3] = ct, -st * ca, st * sa, DH_A[i] * ct
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2], out[..., 1, 3] = st, ct * ca, -ct * sa, DH_A[i] * st
    out[..., 2, 1], out[..., 2, 2], out[..., 2, 3] = sa, ca, DH_D[i]
    out[..., 3, 3] = 1.0
    return out


def _arccos(x: Array) -> Array:
    """arccos that forgives rounding at +-1 and is NaN where there is no angle."""
    return np.arccos(np.where(np.abs(x) < 1 + 1e-9, np.clip(x, -1.0, 1.0), np.nan))


def closed_form(T_base_tool0: Array, wrist_3: ArrayLike = 0.0) -> Array:
    """The eight closed-form solutions of every pose.

    The shoulder follows from the wrist centre (joint 6's origin seen from above), the wrist from how far the flange
    lies off the arm's plane, the elbow from the law of cosines in that plane.

    Args:
        T_base_tool0: (N, 4, 4) wanted poses.
        wrist_3: (N,) or scalar, value of the last joint where the wrist is singular (joints 4 and 6 parallel) [rad].

    Returns:
        (N, 8, 6) joints in [-pi, pi] [rad], rows of NaN where a branch has no solution.
    """
    T06 = np.asarray(T_base_tool0, float) * np.array([-1.0, -1.0, 1.0, 1.0])[:, None]
    # All branches of all poses in one go: the formulas are the same but for three signs.
    shoulder, wrist, elbow = np.tile(list(product((1.0, -1.0), repeat=3)), (len(T06), 1)).T
    last = np.repeat(np.broadcast_to(wrist_3, len(T06)), BRANCHES)
    with np.errstate(invalid="ignore", divide="ignore"):
        q = _branch(np.repeat(T06, BRANCHES, axis=0), shoulder, wrist, elbow, last)
    q = q.reshape(-1, BRANCHES, 6)
    q = (q + np.pi) % _TWO_PI - np.pi
    q[np.isnan(q).any(-1)] = np.nan
    return q


def _branch(T06: Array, shoulder: Array, wrist: Array, elbow: Array, wrist_3: Array) -> Array:
    """(N, 6) one solution per pose (N, 4, 4), the signs (N,) of shoulder, wrist and elbow saying which."""
    d4, d6, a2, a3 = DH_D[3], DH_D[5], DH_A[1], DH_A[2]
    p05 = T06[:, :3, 3] - d6 * T06[:, :3, 2]
    x, y = p05[:, 0], p05[:, 1]
    q1 = np.arctan2(y, x) + shoulder * _arccos(d4 / np.hypot(x, y)) + np.pi / 2
    s1, c1 = np.sin(q1), np.cos(q1)
    q5 = wrist * _arccos((T06[:, 0, 3] * s1 - T06[:, 1, 3] * c1 - d4) / d6)
    s5 = np.sin(q5)
    x_row = T06[:, 0, 0] * s1 - T06[:, 1, 0] * c1
    y_row = T06[:, 0, 1] * s1 - T06[:, 1, 1] * c1
    q6 = np.where(np.abs(s5) > _SINGULAR, np.arctan2(-y_row / s5, x_row / s5), wrist_3)
    T01, T45, T56 = _dh(0, q1), _dh(4, q5), _dh(5, q6)
    T14 = inverse(T01) @ T06 @ inverse(T45 @ T56)
    p13 = T14[:, :3, 3] - d4 * T14[:, :3, 1]
    x, y = p13[:, 0], p13[:, 1]
    q3 = elbow * _arccos((x * x + y * y - a2 * a2 - a3 * a3) / (2 * a2 * a3))
    q2 = np.arctan2(y, x) - np.arctan2(a3 * np.sin(q3), a2 + a3 * np.cos(q3))
    q234 = np.arctan2(T14[:, 1, 0], T14[:, 0, 0])
    return np.stack([q1, q2, q3, q234 - q2 - q3, q5, q6], axis=-1)


def nearest_turn(q: Array, reference: Array) -> Array:
    """(..., 6) joints turned by multiples of 2 pi next to a reference (6,), NaN where beyond their limits [rad]."""
    turned = q + _TWO_PI * np.round((reference - q) / _TWO_PI)
    turned = np.where(turned > ARM_UPPER + 1e-12, turned - _TWO_PI, turned)
    turned = np.where(turned < ARM_LOWER - 1e-12, turned + _TWO_PI, turned)
    inside = (turned >= ARM_LOWER - 1e-12) & (turned <= ARM_UPPER + 1e-12)
    return np.where(inside, np.clip(turned, ARM_LOWER, ARM_UPPER), np.nan)


class ArmIK:
    """Inverse kinematics of one arm model.

    Closed form where the model is the DH table's (checked when built); for a calibrated robot, whose links deviate by
    millimetres, the closed form gives the seeds of a Newton iteration on all poses and branches at once.

    Attributes:
        model: Pinocchio model with the six arm joints.
        tolerance: largest accepted error of a solution, both [m] and [rad].
    """

    tolerance = 1e-9

    def __init__(self, model: pin.Model | None = None):
        self.model = model or load_robot_geometry().with_hand(np.zeros(HAND.joint_count))[0]
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(TOOL0)
        self._order = model_order(self.model)
        # Pinocchio has merged the turn of `base_link_inertia` into the first joint's place; `joint_frames` adds it.
        placed = {k: self.model.jointPlacements[n + 1].homogeneous for n, k in enumerate(self._order)}
        self._origins = np.array([placed[k] for k in range(6)])
        self._origins[0] = np.diag([-1.0, -1.0, 1.0, 1.0]) @ self._origins[0]

    def forward(self, q: ArrayLike) -> Array:
        """(4, 4) T_base_tool0 of (6,) joints [rad], by Pinocchio."""
        pin.framesForwardKinematics(self.model, self.data, np.asarray(q, float)[self._order])
        return self.data.oMf[self.frame].homogeneous.copy()

    def forward_many(self, q: Array) -> Array:
        """(N, 4, 4) T_base_tool0 of (N, 6) joints [rad]."""
        if self.is_dh:
            return dh_forward(np.asarray(q, float))
        return joint_frames(self._origins, q)[:, -1]

    def tcp(self, q: ArrayLike) -> Array:
        """(4, 4) T_base_tcp of (6,) joints [rad]."""
        return self.forward(q) @ T_TOOL0_TCP

    def jacobian(self, q: ArrayLike) -> Array:
        """(6, 6) Jacobian of `tool0` in its own frame: linear rows [m/rad], then angular rows."""
        state = np.asarray(q, float)[self._order]
        full = pin.computeFrameJacobian(self.model, self.data, state, self.frame, pin.LOCAL)
        return full[:, np.argsort(self._order)]

    def manipulability(self, q: ArrayLike) -> float:
        """Yoshikawa's measure sqrt(det(J J^T)); 0 in a singularity."""
        return float(abs(np.linalg.det(self.jacobian(q))))

    @cached_property
    def is_dh(self) -> bool:
        """Whether the model is the DH table's arm to within the tolerance."""
        q = np.random.default_rng(0).uniform(-np.pi, np.pi, (8, 6))
        return all(np.abs(self.forward(row) - dh_forward(row)).max() < self.tolerance for row in q)

    def branches(self, T_base_tool0: Array, wrist_3: ArrayLike = 0.0) -> Array:
        """(N, 8, 6) solutions of (N, 4, 4) poses by branch, in [-pi, pi], NaN where there is none [rad]."""
        poses = np.asarray(T_base_tool0, float).reshape(-1, 4, 4)
        q = closed_form(poses, wrist_3)
        if self.is_dh:
            error = np.abs(dh_forward(q) - poses[:, None])[..., :3, :].max((-2, -1))
            q[~(error < 1e3 * self.tolerance)] = np.nan
            if not np.nanmax(error, initial=0.0) > self.tolerance:
                return q
        there = ~np.isnan(q[..., 0])
        targets = np.broadcast_to(poses[:, None], (*there.shape, 4, 4))
        q[there] = self.refine(targets[there], q[there])
        return q

    def states(self, T_base_tcp: Array, near: Array) -> Array:
        """(K, 6) joints within the limits, on every branch, of (..., 4, 4) poses of `hand_tcp`, pose after pose [rad].

        Every joint is turned next to that of the state `near` (6,).
        """
        found = self.branches(T_base_tcp @ T_TCP_TOOL0, wrist_3=float(near[5])).reshape(-1, 6)
        turned = nearest_turn(found, near)
        return turned[~np.isnan(turned).any(axis=1)]

    def refine(self, T_base_tool0: Array, seeds: Array) -> Array:
        """Newton iteration from (M, 6) seeds [rad] to (M, 4, 4) poses; rows of NaN where it does not converge."""
        q = np.array(seeds, np.float64)
        for _ in range(10):
            frames = joint_frames(self._origins, q)
            place, axes = frames[..., :3, 3], frames[..., :3, 2]
            turn = T_base_tool0[:, :3, :3] @ np.swapaxes(frames[:, -1, :3, :3], 1, 2)
            turned = Rotation.from_matrix(turn).as_rotvec()
            error = np.concatenate([T_base_tool0[:, :3, 3] - place[:, -1], turned], axis=1)
            off = np.abs(error).max(1) >= self.tolerance
            if not off.any():
                break
            # Geometric Jacobian, (M, joint, 6): what a joint does to the tool's place and to its orientation.
            columns = np.concatenate([np.cross(axes, place[:, -1:] - place), axes], axis=-1)
            gram = np.swapaxes(columns, 1, 2) @ columns + 1e-10 * np.eye(6)
            step = (columns @ np.linalg.solve(gram, error[..., None]))[..., 0]
            q[off] += np.clip(step, -0.3, 0.3)[off]
        q[off] = np.nan
        return q

"""Last check of every outgoing trajectory: of the planner that made it, it shares the arm's kinematics alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.arm_model import forward_kinematics
from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, apply
from dgs_description.hand import HAND
from dgs_description.joints import ARM_ACCELERATION, ARM_JOINTS, ARM_LOWER, ARM_UPPER, ARM_VELOCITY
from dgs_description.parameters import parameter

_START_ERROR = 0.02
"""Between the first point and the measured state [rad]."""
_VELOCITY_TOLERANCE = 1.02
"""Share of the maker's velocity limit that is let pass: sampling errs by less than 2 %."""
_ACCELERATION_TOLERANCE = 1.25
"""The same for the acceleration, taken from differences of velocities."""
_LONGEST = 300.0
"""Longest duration of one trajectory [s]: at the least speeds allowed a lift and two turns of a joint take 80."""


@dataclass(frozen=True)
class Envelope:
    """Where no trajectory may lead."""

    tcp_lower: tuple[float, ...] = tuple(CELL.tcp_bounds[0])
    tcp_upper: tuple[float, ...] = tuple(CELL.tcp_bounds[1])
    """Corners of the box in base_link that the TCP stays in [m]."""
    # Compliant fingers may reach this far while they close.
    table_penetration: float = parameter(
        0.015, "No point of the hand goes farther below the table top [m].", 0.0, 0.03
    )


def check_trajectory(
    times: ArrayLike,
    positions: ArrayLike,
    velocities: ArrayLike,
    measured: ArrayLike,
    hand_joints: ArrayLike,
    envelope: Envelope = Envelope(),
) -> None:
    """Refuse a trajectory that is not safe to send.

    Args:
        times, positions, velocities: (N,) [s], (N, 6) arm joints [rad] and [rad/s].
        measured: (6,) arm joints as measured just now [rad].
        hand_joints: (J,) shape in which the hand travels [rad].

    Raises:
        DgsError: SAFETY_ENVELOPE with the bound that is left and by how much.
    """
    t, q, dq = (np.asarray(values, dtype=np.float64) for values in (times, positions, velocities))
    _check_shape(t, q, dq)
    _check_joints(q)
    _check_rates(t, q, dq)
    joint, off = _worst(np.abs(q[:1] - np.asarray(measured, float)))
    if off > _START_ERROR:
        allowed = f"{_START_ERROR:g} rad are allowed"
        raise _unsafe(f"starts {off:.3f} rad away from the measured {joint}; {allowed}")
    _check_hand(q, np.asarray(hand_joints, float), envelope)


def _check_shape(t: Array, q: Array, dq: Array) -> None:
    if t.ndim != 1 or len(t) < 2 or q.shape != (len(t), 6) or dq.shape != q.shape:
        shapes = f"{t.shape}, {q.shape}, {dq.shape}; needed are (N,), (N, 6), (N, 6), N >= 2"
        raise _unsafe(f"has arrays of shapes {shapes}")
    if not (np.isfinite(t).all() and np.isfinite(q).all() and np.isfinite(dq).all()):
        raise _unsafe("holds numbers that are not finite")
    if t[0] != 0.0 or (np.diff(t) <= 0).any():
        raise _unsafe("has times that do not increase from 0")
    if t[-1] > _LONGEST:
        raise _unsafe(f"takes {t[-1]:.1f} s; {_LONGEST:g} s are allowed")


def _check_joints(q: Array) -> None:
    joint, excess = _worst(np.maximum(ARM_LOWER - q, q - ARM_UPPER))
    if excess > 1e-6:
        raise _unsafe(f"takes {joint} {excess:.3f} rad beyond its limit")


def _check_rates(t: Array, q: Array, dq: Array) -> None:
    step = np.diff(t)[:, None]
    if np.abs(dq[[0, -1]]).max() > 1e-6:
        raise _unsafe("does not start and end at rest")
    # Between two samples both the stated velocities and the way covered count.
    for speed in (dq, np.diff(q, axis=0) / step):
        joint, ratio = _worst(np.abs(speed) / ARM_VELOCITY)
        if ratio > _VELOCITY_TOLERANCE:
            raise _unsafe(f"moves {joint} at {ratio:.2f} times its velocity limit")
    joint, ratio = _worst(np.abs(np.diff(dq, axis=0) / step) / ARM_ACCELERATION)
    if ratio > _ACCELERATION_TOLERANCE:
        raise _unsafe(f"accelerates {joint} at {ratio:.2f} times its limit")


def _check_hand(q: Array, hand_joints: Array, bounds: Envelope) -> None:
    """TCP in its box, and no point of palm and fingers below the table's plane within the table's outline."""
    spheres = HAND.finger_spheres(hand_joints)
    points = apply(HAND.T_mount_tcp, np.concatenate([spheres.reshape(-1, 3), HAND.palm_points(0.05)]))
    radii = np.concatenate([HAND.all_radii, np.zeros(len(points) - spheres.size // 3)])
    centre, half = np.array(CELL.table_centre), np.array(CELL.table_size[:2]) / 2
    for joints in q:
        T_base_tool0 = forward_kinematics(joints)
        tcp = apply(T_base_tool0, HAND.T_mount_tcp[:3, 3])
        if (tcp < bounds.tcp_lower).any() or (tcp > bounds.tcp_upper).any():
            raise _unsafe("takes the TCP to ({:.3f}, {:.3f}, {:.3f}) m, outside of its box".format(*tcp))
        placed = apply(T_base_tool0, points)
        over = (np.abs(placed[:, :2] - centre) < half).all(1)
        if over.any():
            lowest = float((placed[over, 2] - radii[over]).min())
            if lowest < CELL.table_height - bounds.table_penetration:
                depth = CELL.table_height - lowest
                raise _unsafe(f"takes the hand {depth * 1e3:.0f} mm below the table top")


def _worst(values: Array) -> tuple[str, float]:
    """The joint with the largest of (N, 6) values, and that value."""
    largest = values.max(0)
    return ARM_JOINTS[int(np.argmax(largest))], float(largest.max())


def _unsafe(what: str) -> DgsError:
    return DgsError(ErrorCode.SAFETY_ENVELOPE, f"the trajectory {what}; it was not sent")

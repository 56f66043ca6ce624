"""Joints that bring fingertips, or the balls that end the fingers, to given points, within the limits.

Fingers of a yaw and three parallel flexions, the last following the middle one, which bends forwards only, have a
closed form but for one root (`_planar`); any other chain goes by damped least squares (Wampler, 1986).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dgs_description.frames import Array
from dgs_description.hand_model import HandModel

_PLANAR_AXES = np.array([(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
_TABLE, _NEWTON = 64, 3
"""Places of the middle joint among which the root is looked for first, and steps that make it exact."""
_STEPS, _DAMPING = 60, 0.004
"""Of the damped least squares; damping in metres per radian."""


def inverse_kinematics(hand: HandModel, targets: Array) -> Array:
    """Joint angles that bring the fingertips to given points.

    Args:
        targets: (..., F, 3) wanted fingertip points in `hand_tcp` [m].

    Returns:
        (..., F, 4) joints within the limits [rad]; exact where the target is reachable, else near to it. A yaw that
        follows another finger's is that one's, which says nothing where that finger is curled over its own axis; damped
        least squares miss some targets (of the Allegro hand about one in a hundred).
    """
    if _is_planar(hand):
        return _as_coupled(hand, _planar(hand, targets, hand.steps[:, 3, 1]))
    return _damped(hand, targets, hand.fingertips)


def reach_with_balls(hand: HandModel, targets: Array) -> Array:
    """Joint angles that bring the fingers' end balls to given points.

    Args:
        targets: (..., F, 3) wanted centres in `hand_tcp` [m].

    Returns:
        (..., F, 4) joints [rad]; mostly within 0.1 mm where the target is reachable, as `inverse_kinematics` else.
    """
    if not _is_planar(hand):
        return _damped(hand, targets, hand.end_balls)
    ends, aim = np.array([links[2].end for links in hand.capsules]), targets
    for _ in range(3):  # the balls' centres lie a little beside the axis
        joints = _planar(hand, aim, ends)
        aim = aim + np.clip(targets - hand.end_balls(joints), -0.001, 0.001)
    return _as_coupled(hand, _planar(hand, aim, ends))


def _is_planar(hand: HandModel) -> bool:
    straight = not hand.steps[:, :, [0, 2]].any()
    forwards = (hand.split(hand.lower)[:, 2] >= 0.0).all()  # one distance, one middle joint
    return bool(straight and forwards and hand.coupled.all() and (hand.axes == _PLANAR_AXES).all())


def _planar(hand: HandModel, targets: Array, last: Array) -> Array:
    """The distance r of joint 2 to a point on the distal link depends on the middle joint m alone.

    With theta4 = k m: r^2 = L1^2 + L2^2 + L3^2 + 2 L1 L2 cos m + 2 L2 L3 cos k m + 2 L1 L3 cos (1 + k) m, which falls
    with m. Newton's method goes in c = cos m, in which it is nearly straight.
    """
    lower, upper = hand.split(hand.lower), hand.split(hand.upper)
    local = np.einsum("fji,...fj->...fi", hand.base_poses[:, :3, :3], targets - hand.base_poses[:, :3, 3])
    distal = np.where(np.abs(local[..., 1]) < 1e-4, 1e-4, local[..., 1])
    yaw = np.arctan(-local[..., 0] / distal)
    turns_back = np.maximum(-lower[:, 0], upper[:, 0]) > np.pi / 2
    if turns_back.any():  # then the target may be ahead of the finger or, where that is curled, behind it
        ahead = np.arctan2(-local[..., 0], local[..., 1])
        behind = ahead - np.copysign(np.pi, ahead)
        found = [_flexed(hand, local, np.where(turns_back, each, yaw), last) for each in (ahead, behind)]
        miss = [np.linalg.norm(place - local, axis=-1) for _, place in found]
        return np.where((miss[0] <= miss[1])[..., None], found[0][0], found[1][0])
    return _flexed(hand, local, yaw, last)[0]


def _flexed(hand: HandModel, local: Array, yaw: Array, last: Array) -> tuple[Array, Array]:
    """Joints (..., F, 4) of a wanted yaw [rad], and the places (..., F, 3) that they reach, as `local` [m]."""
    lower, upper = hand.split(hand.lower), hand.split(hand.upper)
    knuckle, l1, l2 = hand.steps[:, 0, 1], hand.steps[:, 1, 1], hand.steps[:, 2, 1]
    k = hand.split(hand.ratio)[:, 3]
    yaw = np.clip(yaw, lower[:, 0], upper[:, 0])
    a = -np.sin(yaw) * local[..., 0] + np.cos(yaw) * local[..., 1] - knuckle
    b = local[..., 2]
    wanted = a * a + b * b

    def square(c: Array) -> tuple[Array, Array]:
        m = np.arccos(c)
        sin = np.maximum(np.sin(m), 1e-9)
        value = l1**2 + l2**2 + last**2 + 2 * l1 * l2 * c + 2 * l2 * last * np.cos(k * m)
        slope = 2 * l1 * l2 + 2 * l2 * last * k * np.sin(k * m) / sin
        more = (1 + k) * m
        return value + 2 * l1 * last * np.cos(more), slope + 2 * l1 * last * (1 + k) * np.sin(more) / sin

    low, high = np.cos(upper[:, 2]), np.cos(lower[:, 2])
    places = low + np.linspace(0.0, 1.0, _TABLE)[:, None] * (high - low)
    known = square(places)[0]
    c = np.stack(
        [np.interp(wanted[..., f], known[:, f], places[:, f]) for f in range(len(hand.fingers))], axis=-1
    )
    for _ in range(_NEWTON):
        value, slope = square(c)
        c = np.clip(c - (value - wanted) / slope, low, high)
    middle = np.clip(np.arccos(c), lower[:, 2], upper[:, 2])
    across = l2 * np.sin(middle) + last * np.sin((1 + k) * middle)
    along = l1 + l2 * np.cos(middle) + last * np.cos((1 + k) * middle)
    pitch = np.clip(np.arctan2(b, a) - np.arctan2(across, along), lower[:, 1], upper[:, 1])
    out = knuckle + np.cos(pitch) * along - np.sin(pitch) * across
    place = [-np.sin(yaw) * out, np.cos(yaw) * out, np.sin(pitch) * along + np.cos(pitch) * across]
    return np.stack([yaw, pitch, middle, k * middle], axis=-1), np.stack(place, axis=-1)


def _damped(hand: HandModel, targets: Array, points: Callable[[Array], Array]) -> Array:
    """Steps J^T (J J^T + d^2)^-1 e from a bent start, clipped to the limits; coupled joints follow."""
    lower, upper = hand.split(hand.lower), hand.split(hand.upper)
    shape = targets.shape[:-1]
    q = np.broadcast_to(lower + 0.35 * (upper - lower), (*shape, 4)).copy()
    q = _as_coupled(hand, q)
    free = np.zeros(len(hand.joints))
    free[hand.driven] = 1.0
    eye, step = np.eye(3) * _DAMPING**2, 1e-5
    for _ in range(_STEPS):
        error = targets - points(q)
        moved = [points(q + step * unit) - points(q - step * unit) for unit in np.eye(4)]
        jacobian = np.stack(moved, axis=-1) / (2 * step)
        jacobian = jacobian * hand.split(free)[:, None, :]
        solved = np.linalg.solve(jacobian @ np.swapaxes(jacobian, -1, -2) + eye, error[..., None])
        change = (np.swapaxes(jacobian, -1, -2) @ solved)[..., 0]
        q = np.clip(q + np.clip(change, -0.3, 0.3), lower, upper)
        q = _as_coupled(hand, q)
    return q


def _as_coupled(hand: HandModel, joints: Array) -> Array:
    """(..., F, 4) joints of which those that follow another do so, those that are locked stand."""
    return hand.split(hand.expand(hand.reduce(joints.reshape(*joints.shape[:-2], hand.joint_count))))

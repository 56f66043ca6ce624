"""The hand of a pinch whose end balls lie on one line across the thing, before and at contact.

The thumb is shorter than the fingers. So the hand leans towards the thumb until all balls are equally deep.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.hand_ik import reach_with_balls

_FACTS = HAND.grasp.level_pinch
ACTIVE = np.zeros(HAND.finger_count, dtype=bool) if _FACTS is None else _FACTS.active
"""(F,) fingers that take part; a hand without any has no level pinches."""
LEAN = 0.0 if _FACTS is None else _FACTS.lean
"""Of the hand towards the thumb [rad]."""
_OUT_OF_THE_WAY = 0.025
"""So much less deep a finger that takes no part is held [m]."""
_WIDTH_STEP = 0.003
_NARROWER = 0.004
"""The balls can come so much nearer to the thing's middle on either side, still level: widths are seen roughly [m]."""
_DEPTHS, _SHIFTS = np.arange(0.005, 0.0301, 0.0025), np.arange(-0.030, 0.0301, 0.002)
"""Where the balls may be: so far before the TCP, and so far to the thumb's side of it [m]."""
_CLEAR = 0.003
"""Between an open hand and what it takes in [m]."""
_CLOSING_STEPS, _TOUCH = 61, 2e-4
"""Shapes between an open hand and a closed one, and so deep [m] a finger is still outside."""
_UNLEVEL = 0.1
"""A hand may be so much less level for every unit that it takes the thing in deeper, or its fingers end sooner."""


class Stance(NamedTuple):
    """Joints (F, 4) before and at contact [rad], and the middle (3,) between the balls in `hand_tcp` [m]."""

    before: Array
    final: Array
    middle: Array


def hand_axes(across: Array, ahead: Array, lean: float) -> Array:
    """(..., 3, 3) axes of a leaning `hand_tcp`.

    Args:
        across: (..., 3) unit vectors from the fingers to the thumb.
        ahead: (..., 3) unit vectors across to them, the way in which the balls are ahead of the TCP.
        lean: [rad].
    """
    side, deep = _axes(lean)
    return np.stack([across, np.cross(ahead, across), ahead], axis=-1) @ np.stack([side, [0, 1, 0], deep])


def level_stance(width: float, lean: float, room: float) -> Stance:
    """The pinch of a thing `width` wide: of all places of the balls in the hand, where they come nearest to one depth.

    Args:
        width: between thumb and fingers [m].
        lean: of the hand [rad].
        room: between the balls and the thing on either side before they close [m].
    """
    return _stance(round(width / _WIDTH_STEP), lean, room)


def _axes(lean: float) -> tuple[Array, Array]:
    """In `hand_tcp` of a leaning hand: from the fingers to the thumb; and the way ahead."""
    return np.array([np.cos(lean), 0.0, -np.sin(lean)]), np.array([np.sin(lean), 0.0, np.cos(lean)])


def open_stance(width: float, lean: float, wanted: float) -> tuple[Stance, float]:
    """The pinch of a broad thing that an open hand takes in before it closes.

    A hand that is opened just so far that its balls come past the thing meets a thick one with its fingers' roots.

    Args:
        width: as of `level_stance`, lean: likewise.
        wanted: so deep the thing shall be between the fingers [m].

    Returns:
        The stance, of all places of the balls the one where the thing comes deep enough, the balls end nearest to one
        depth and the open fingers not far beyond, with every finger closed until it touches; and how far before the
        balls the thing may end without meeting anything else [m].
    """
    return _open_stance(round(width / _WIDTH_STEP), lean, wanted)


@cache
def _stance(width_steps: int, lean: float, room: float) -> Stance:
    middle, half = _middles(lean), width_steps * _WIDTH_STEP / 2
    joints, error = zip(*(_reach(middle, half + by, lean) for by in (room, 0.0, -_NARROWER)), strict=True)
    best = int(np.max(error, axis=0).argmin())
    return Stance(joints[0][best], joints[1][best], middle[best])


@cache
def _open_stance(width_steps: int, lean: float, wanted: float) -> tuple[Stance, float]:
    middle, half = _middles(lean), width_steps * _WIDTH_STEP / 2
    joints, error = zip(*(_reach(middle, half - by, lean) for by in (0.0, _NARROWER)), strict=True)
    opened = np.broadcast_to(HAND.split(HAND.open_hand), joints[0].shape).copy()
    # Spread as when closed: a finger that swings meets the thing beside its place.
    opened[..., 0] = joints[0][..., 0]
    depth, past = _depth(opened, middle, half + _CLEAR, lean), -_depth(opened, middle, np.inf, lean)
    gain = np.minimum(depth, wanted) - np.maximum(past, HAND.ball_radius)
    best = int((np.max(error, axis=0) - _UNLEVEL * gain).argmin())
    slab = half, min(float(depth[best]), wanted)
    final = _closed(opened[best], joints[0][best], middle[best], slab, lean)
    return Stance(opened[best], final, middle[best]), float(depth[best])


def _closed(opened: Array, final: Array, middle: Array, slab: tuple[float, float], lean: float) -> Array:
    """(F, 4) each finger as far from `opened` to `final` as it gets before any part of it is inside of a slab.

    Args:
        opened, final: (F, 4) [rad].
        middle: (3,) between the balls, in `hand_tcp` [m].
        slab: half of its thickness, and how far before the middle it ends [m].
        lean: of the hand [rad].
    """
    half, inset = slab
    side, down = _axes(lean)
    shapes = opened + np.linspace(0.0, 1.0, _CLOSING_STEPS)[:, None, None] * (final - opened)
    points = HAND.finger_spheres(shapes) - middle
    gap = np.where(points @ down > -inset, abs(points @ side) - half - HAND.sphere_radii, np.inf).min(axis=-1)
    outside = np.logical_and.accumulate(gap > -_TOUCH, axis=0).sum(axis=0)
    return shapes[np.maximum(outside - 1, 0), np.arange(HAND.finger_count)]


def _middles(lean: float) -> Array:
    """(M, 3) places between the balls, in `hand_tcp`."""
    assert _FACTS is not None, "no stance: propose only where `ACTIVE` has fingers"
    side, down = _axes(lean)
    depth, shift = (grid.ravel() for grid in np.meshgrid(_DEPTHS, _SHIFTS))
    middle = depth[:, None] * down + shift[:, None] * side
    middle[:, 1] = HAND.base_poses[list(_FACTS.between), 1, 3].mean() + _FACTS.shift  # where the thumb stands
    return middle


def _reach(middle: Array, half: float, lean: float) -> tuple[Array, Array]:
    """(M, F, 4) joints with the balls `half` [m] and their radius on both sides of (M, 3); (M,) how unlevel [m]."""
    side, down = _axes(lean)
    balls = np.repeat(middle[:, None], HAND.finger_count, axis=1)
    balls[:, 0] += (half + HAND.ball_radius) * side
    balls[:, 1:] -= (half + HAND.ball_radius) * side
    balls[:, 1:, 1] = HAND.base_poses[1:, 1, 3]
    balls[:, ~ACTIVE] -= _OUT_OF_THE_WAY * down
    joints = reach_with_balls(HAND, balls)
    off = (HAND.end_balls(joints) - balls)[:, ACTIVE]
    return joints, np.maximum(abs(off @ down), 0.5 * abs(off @ side)).max(axis=1)


def _depth(joints: Array, middle: Array, half: float, lean: float) -> Array:
    """(M,) how far before (M, 3) a slab of twice `half` may end that the hand (M, F, 4) takes in [m]; < 0: ahead."""
    side, down = _axes(lean)
    fingers, palm = HAND.finger_spheres(joints)[:, ACTIVE], HAND.palm_points()
    points = np.concatenate([fingers.reshape(len(middle), -1, 3), np.tile(palm, (len(middle), 1, 1))], axis=1)
    points = points - middle[:, None]
    radii = np.concatenate([np.tile(HAND.sphere_radii, ACTIVE.sum()), np.zeros(len(palm))])
    beside = np.maximum(abs(points @ side) - half, 0.0)
    fronts = points @ down + np.sqrt(np.maximum(radii**2 - beside**2, 0.0))
    return -np.where(beside <= radii, fronts, -np.inf).max(axis=1)

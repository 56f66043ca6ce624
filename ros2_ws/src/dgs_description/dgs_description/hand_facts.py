"""What a hand's folder says besides joints and lengths: shapes and masses of its parts, and how it grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array

Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Capsule:
    """A capsule in the y-z plane of a finger link's frame: axis from (0, start, height) to (0, end, height)."""

    radius: float
    start: float
    end: float
    height: float


@dataclass(frozen=True)
class LevelPinch:
    """The stance of a hand that pinches low things.

    Attributes:
        active: (F,) fingers that take part.
        between: fingers between which the thumb stands, moved by `shift` along y [m].
        lean: of the hand towards the thumb, so that thumb and fingers are equally deep [rad].
    """

    active: Mask
    between: tuple[int, ...]
    shift: float
    lean: float


@dataclass(frozen=True)
class GraspFacts:
    """How this hand grasps: what the fingertip constraints and the geometric proposers need.

    Attributes:
        widest: thing that the hand closes on [m].
        pre_grasp: (4,) share of each bending joint that the pre-grasp keeps (paper, equation 9).
        beyond: (4,) how far past its final joints a finger that meets nothing goes on, feeling for the object [rad].
        patterns: by number of fingers that take part, from two on: (P, F).
        tip_plane: fingertip plane of the open hand above the TCP [m].
        tip_delta: (F,) delta_i of equations (7d) and (8c) [m].
        circle: (F,) angle of every fingertip under the circular constraint [rad].
        rectangle: (F,) y of every fingertip under the rectangular constraint [m].
        thumb_share: of the half width at which the thumb stands under the rectangular constraint.
        level_pinch: stance for low things; None = the hand has none.
        push: the two fingers whose backs push, and (F,) pitch of all then [rad]; None = it does not push.
        stiffness: (4,) of the virtual springs that close a finger [Nm/rad]; the thumb's are stiffer by `thumb_factor`.
    """

    widest: float
    pre_grasp: Array
    beyond: Array
    patterns: Mask
    tip_plane: float
    tip_delta: Array
    circle: Array
    rectangle: Array
    thumb_share: float
    level_pinch: LevelPinch | None
    push: tuple[tuple[int, int], Array] | None
    stiffness: Array
    thumb_factor: float


@dataclass(frozen=True)
class LinkFacts:
    """Mass [kg] and centre of mass [m] of the palm or one of a finger's links."""

    mass: float
    centre_of_mass: tuple[float, float, float]

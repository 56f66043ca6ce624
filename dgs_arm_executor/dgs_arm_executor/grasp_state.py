"""Whether the hand holds something, from its joints, and whether it has let go, from joints and torques."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.hand_model import SPHERE_RADII, finger_spheres
from dgs_description.joints import FINGERS, HAND_LOWER, HAND_UPPER


@dataclass(frozen=True)
class HoldSettings:
    """When a finger counts as held off by an object."""

    closing_margin: tuple[float, float, float] = (0.0, 0.20, 0.14)
    """What the hand driver adds to the final joints as closing target: yaw, pitch, middle [rad]."""
    shortfall: float = 0.05
    """A finger that stays this far before its closing target is held off [rad]."""
    takes_part: float = 0.05
    """A finger whose flexion changes less than this from pre-grasp to grasp is idle [rad]."""
    fingers: int = 2
    """So many fingers must be held off."""
    opened: float = 0.25
    """A finger that has flexed back this much since it held does not hold any more [rad]."""
    pressing: float = 0.05
    """A finger with less torque in pitch and middle joint does not press on anything [Nm]."""
    own_contact: float = 0.003
    """Nearer than this the thumb and a finger hold off each other [m]."""


def fingers_held_off(
    measured: ArrayLike,
    pre_grasp_joints: ArrayLike,
    grasp_joints: ArrayLike,
    settings: HoldSettings | None = None,
) -> NDArray[np.bool_]:
    """Which fingers something keeps from their closing target.

    An empty hand closes to its target, the final joints plus the driver's margin. Fingers that stop before it touch an
    object, or the thumb and a finger touch each other: those two do not count.

    Args:
        measured: (20,) hand joints [rad].
        pre_grasp_joints, grasp_joints: (20,) of the grasp [rad].
        settings: thresholds.

    Returns:
        (5,) thumb, index, middle, ring, little.
    """
    settings = settings or HoldSettings()
    now, pre, final = (np.asarray(q, float).reshape(5, 4) for q in (measured, pre_grasp_joints, grasp_joints))
    margin = np.array([*settings.closing_margin, settings.closing_margin[2]])
    target = np.clip(final + margin, HAND_LOWER.reshape(5, 4), HAND_UPPER.reshape(5, 4))
    active = np.abs(final - pre)[:, 1:3].max(1) > settings.takes_part
    held = active & ((target - now)[:, 1:3].max(1) > settings.shortfall)
    return held & ~_touching_each_other(now, settings.own_contact)


def object_held(
    measured: ArrayLike,
    pre_grasp_joints: ArrayLike,
    grasp_joints: ArrayLike,
    settings: HoldSettings | None = None,
) -> bool:
    """Whether enough fingers are held off by an object (arguments as in `fingers_held_off`)."""
    settings = settings or HoldSettings()
    held = fingers_held_off(measured, pre_grasp_joints, grasp_joints, settings)
    return int(held.sum()) >= settings.fingers


def let_go(measured: ArrayLike, while_held: ArrayLike, settings: HoldSettings | None = None) -> bool:
    """Whether an object that was held is free although not every finger may have opened.

    Args:
        measured: (20,) hand joints now [rad].
        while_held: (20,) hand joints while the object was held [rad].
        settings: thresholds.

    Returns:
        True if fewer fingers than holding takes are still as flexed as they were.
    """
    settings = settings or HoldSettings()
    now, held = (np.asarray(q, float).reshape(5, 4)[:, 1:3].sum(1) for q in (measured, while_held))
    still = (held > settings.opened) & (held - now < settings.opened)
    return int(still.sum()) < settings.fingers


def dropped_out(
    torques: ArrayLike | None, while_held: ArrayLike | None, settings: HoldSettings | None = None
) -> bool:
    """Whether fingers that were stopped as soon as they began to open press on nothing any more.

    They stand where they held, so their joints do not tell. Nor do torques of a hand that showed none while it held.

    Args:
        torques: (20,) of the hand at rest, positive in closing direction [Nm]; None = unknown.
        while_held: (20,) while the object was held [Nm]; None = unknown.
        settings: thresholds.
    """
    settings = settings or HoldSettings()
    if torques is None or while_held is None:
        return False
    now, before = (
        int((np.asarray(t, float).reshape(5, 4)[:, 1:3].max(1) > settings.pressing).sum())
        for t in (torques, while_held)
    )
    return now < settings.fingers <= before


def names(held: NDArray[np.bool_]) -> str:
    """Finger names of a (5,) mask for a sentence."""
    return ", ".join(finger for finger, flag in zip(FINGERS, held, strict=True) if flag) or "no finger"


def _touching_each_other(joints: NDArray[np.float64], distance: float) -> NDArray[np.bool_]:
    """(5,) the thumb and those fingers whose shapes touch it."""
    centres = finger_spheres(joints)
    gaps = np.linalg.norm(centres[0][None, :, None] - centres[1:, None], axis=-1)
    gaps -= SPHERE_RADII[:, None] + SPHERE_RADII
    touching = gaps.min((1, 2)) < distance
    return np.append(touching.any(), touching)

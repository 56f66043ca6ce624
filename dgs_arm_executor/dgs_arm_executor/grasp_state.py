"""Whether the hand holds something, from its joints, and whether it has let go, from joints and torques."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.situation import ArmSituation
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.parameters import parameter
from dgs_description.pick import closing_limit

Mask = NDArray[np.bool_]

_HOLDING = 2
"""So many fingers hold an object; one alone is jammed."""
_OPENED = 0.25
"""A finger that has flexed back this much since it held does not hold any more [rad]."""
_OPEN = 0.1
"""A hand whose fingers are all bent by no more holds nothing: a simulated one was started anew [rad]."""
_PRESSING = 0.05
"""A finger with less torque in pitch and middle joint does not press on anything [Nm] (docs/arm_executor.md)."""


@dataclass(frozen=True)
class HoldSettings:
    """When a finger counts as held off by an object."""

    held_shortfall: float = parameter(
        0.05, "A finger this far before its closing target is held off by an object [rad].", 0.01, 0.5
    )
    own_contact: float = 0.003
    """Nearer than this the thumb and a finger hold off each other [m]."""


def fingers_held_off(
    hand_joints: ArrayLike, grasp: GraspSet, settings: HoldSettings = HoldSettings()
) -> Mask:
    """Which of a grasp's active fingers something keeps from their closing limit.

    An empty hand feels on until `closing_limit`. Fingers that stop before it touch an object, or the thumb and a finger
    touch each other: those two do not count.

    Args:
        hand_joints: (J,) measured after closing to the grasp [rad].

    Returns:
        (F,) thumb, index, middle, ring, little.
    """
    now = HAND.split(np.asarray(hand_joints, float))
    limit = HAND.split(closing_limit(grasp.grasp_joints, grasp.active_fingers))
    short = (limit - now)[:, 1:3].max(1) > settings.held_shortfall
    return grasp.active_fingers & short & ~_touching_each_other(now, settings.own_contact)


def object_held(hand_joints: ArrayLike, grasp: GraspSet, settings: HoldSettings = HoldSettings()) -> bool:
    """Whether enough fingers are held off by an object (arguments as in `fingers_held_off`)."""
    return int(fingers_held_off(hand_joints, grasp, settings).sum()) >= _HOLDING


def is_open(hand_joints: NDArray[np.float64]) -> bool:
    """Whether a hand with (J,) joints [rad] is open and empty, whatever it held when it was last looked at."""
    bent = np.abs(HAND.split(hand_joints) - HAND.split(HAND.open_hand))
    return bool(bent[HAND.flexes].max() < _OPEN)


def has_let_go(before: ArmSituation, now: ArmSituation, jammed: bool) -> bool:
    """Whether an object that was held is free although the hand was ended while it opened.

    It is where fewer fingers than holding takes are still as flexed as they were. Fingers that were stopped as soon as
    they began to open stand where they held; then their torques tell whether they still press on something, unless the
    hand is `jammed` (a fault of its own ended its motion), for jammed fingers press on what jams them, or showed no
    torques while it held.
    """
    flexed_now, flexed_before = (HAND.split(s.hand_joints)[:, 1:3].sum(1) for s in (now, before))
    still = (flexed_before > _OPENED) & (flexed_before - flexed_now < _OPENED)
    if int(still.sum()) < _HOLDING:
        return True
    return not jammed and grip_lost(before, now)


def grip_lost(before: ArmSituation, now: ArmSituation) -> bool:
    """Whether fewer fingers than holding takes still press on something, and enough did; False where nobody can say."""
    return _pressing(now) < _HOLDING <= _pressing(before)


def names(held: Mask) -> str:
    """Finger names of a (F,) mask for a sentence."""
    return ", ".join(compress(HAND.fingers, held)) or "no finger"


def _pressing(situation: ArmSituation) -> float:
    """How many fingers press on something; NaN where nobody can say."""
    if situation.hand_torques is None:
        return float("nan")
    return int((HAND.split(situation.hand_torques)[:, 1:3].max(1) > _PRESSING).sum())


def _touching_each_other(joints: NDArray[np.float64], distance: float) -> Mask:
    """(F,) the thumb and those fingers whose shapes touch it."""
    centres = HAND.finger_spheres(joints)
    gaps = np.linalg.norm(centres[0][None, :, None] - centres[1:, None], axis=-1)
    gaps -= HAND.sphere_radii[:, None] + HAND.sphere_radii
    touching = gaps.min((1, 2)) < distance
    return np.append(touching.any(), touching)

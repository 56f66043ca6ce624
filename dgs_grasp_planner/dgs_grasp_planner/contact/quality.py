"""How well a closed hand holds, judged by where its fingers met the observed cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import ContactPoints, Mask
from dgs_grasp_planner.contact.height_field import HeightField

NO_HOLD = 0.05
"""Quality of a hand that holds nothing: it comes after all others."""
LIFT = 0.22
"""What is held beside its middle, as by a rim, turns in the hand, unless the contact next to the middle is the higher
one: by so much times how far the middle is beyond it, for a bowl of 330 g."""
SAG, SAGGING = 0.012, 0.6
"""With so much lacking [m] a hold is worth this share. Of 36 tries with that bowl in MuJoCo, those with less than 4 mm
held in 13 of 15, with more in 3 of 21."""


@dataclass(frozen=True)
class Pinch:
    """N hands seen as a thumb against the mean of the other fingers that touch.

    Attributes:
        thumb, fingers: (N, 3) contact points [m].
        line: (N, 3) unit vector from thumb to fingers.
        opposition: (N,) of the normals at the thumb and the fingers, 1 = opposite.
        thumb_alignment, finger_alignment: (N,) of the normals with the line, 1 = along it.
        others: (N,) number of fingers that touch besides the thumb.
    """

    thumb: Array
    fingers: Array
    line: Array
    opposition: Array
    thumb_alignment: Array
    finger_alignment: Array
    others: NDArray[np.int64]

    @property
    def middle(self) -> Array:
        """(N, 3) between thumb and fingers [m]."""
        return (self.thumb + self.fingers) / 2

    @property
    def level_line(self) -> Array:
        """(N, 2) unit vector from thumb to fingers, seen from above; zero for an upright line."""
        flat = self.line[:, :2]
        return np.asarray(flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6))


def pinch(touched: ContactPoints) -> Pinch:
    """The pinch of N hands; without meaning where thumb or fingers touch nothing."""
    weight = touched.met[:, 1:].astype(float)
    others = weight.sum(axis=1)
    total = np.maximum(others, 1.0)[:, None]
    fingers = (touched.point[:, 1:] * weight[..., None]).sum(axis=1) / total
    normal = (touched.normal[:, 1:] * weight[..., None]).sum(axis=1) / total
    thumb, thumb_normal = touched.point[:, 0], touched.normal[:, 0]
    line = fingers - thumb
    line = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-6)
    return Pinch(
        thumb=thumb,
        fingers=fingers,
        line=line,
        opposition=-(thumb_normal * normal).sum(axis=1),
        thumb_alignment=-(thumb_normal * line).sum(axis=1),
        finger_alignment=(normal * line).sum(axis=1),
        others=others.astype(np.int64),
    )


@dataclass(frozen=True)
class Contacts:
    """What speaks for N closed hands, each (N,).

    Attributes:
        pinch: thumb against fingers.
        owner: number of the shape between them, 0 = none, or two.
        enough: thumb and at least two fingers (or all the active ones) met something.
        fingers: share of the hand's that met something.
        offset: distance of the pinch line to the middle of the shape between the fingers, horizontally [m].
        depth: of the contacts below the top of the shape [m].
        steep: 1 = straight down.
        sag: how much higher the contact next to the shape's middle would have to be, for that it does not hang [m].
    """

    pinch: Pinch
    owner: NDArray[np.int32]
    enough: Mask
    fingers: Array
    offset: Array
    depth: Array
    steep: Array
    sag: Array

    def quality(self) -> Array:
        """(N,) in [`NO_HOLD`, 1]. Weights by hand; weights fitted to 728 executed candidates did no better."""
        alignment = np.minimum(self.pinch.thumb_alignment, self.pinch.finger_alignment)
        value = (
            0.30 * np.clip(self.pinch.opposition, 0, 1)
            + 0.25 * np.clip(alignment, 0, 1)
            + 0.15 * self.fingers
            + 0.15 * np.clip(1 - self.offset / 0.05, 0, 1)
            + 0.10 * np.clip(self.depth / 0.02, 0, 1)
            + 0.05 * np.clip(self.steep, 0, 1)
        )
        value *= SAGGING + (1 - SAGGING) * np.clip(1 - self.sag / SAG, 0, 1)
        return np.where(self.enough, np.maximum(value, NO_HOLD), NO_HOLD)


def contacts(rotation: Array, touched: ContactPoints, active: Mask, field: HeightField) -> Contacts:
    """What the fingers of N hands met.

    Args:
        rotation: (N, 3, 3) of `hand_tcp`, frame *table*.
        touched: where their fingers ended.
        active: (N, F) fingers that take part.
        field: what stands there.
    """
    found = pinch(touched)
    middle, flat = found.middle, found.level_line
    owner, point = field.between(found.thumb, found.fingers)
    away = middle[:, :2] - field.centres[owner]
    offset = np.abs(away[:, 0] * flat[:, 1] - away[:, 1] * flat[:, 0])
    across, along = found.fingers - found.thumb, -(away * flat).sum(axis=1)
    return Contacts(
        pinch=found,
        owner=owner,
        enough=touched.met[:, 0] & (found.others >= np.minimum(2, active[:, 1:].sum(axis=1))),
        fingers=touched.met.sum(axis=1) / HAND.finger_count,
        offset=np.where(owner > 0, offset, np.inf),
        depth=np.where(owner > 0, field.top(point) - middle[:, 2], 0.0),
        steep=-rotation[:, 2, 2],
        sag=np.where(owner > 0, sag(across, along), 0.0),
    )


def sag(across: Array, along: Array) -> Array:
    """(N,) as in `Contacts`; zero where the middle of the shape is between thumb and fingers.

    Args:
        across: (N, 3) from the thumb's contact to the fingers' [m].
        along: (N,) how far the shape's middle is from theirs, towards the fingers, horizontally [m].
    """
    beyond = np.abs(along) - np.linalg.norm(across[:, :2], axis=1) / 2
    return np.where(beyond > 0, np.maximum(LIFT * beyond - np.sign(along) * across[:, 2], 0.0), 0.0)

"""Contact quality: what speaks for hands whose fingers touch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_grasp_planner.contact.closing import Contacts
from dgs_grasp_planner.contact.height_field import HeightField

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNHELD = 0.05
"""Quality of a hand that holds nothing: it comes after all others."""


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


def pinch(contacts: Contacts) -> Pinch:
    """The pinch of N hands; without meaning where thumb or fingers touch nothing."""
    weight = contacts.met[:, 1:].astype(float)
    others = weight.sum(axis=1)
    total = np.maximum(others, 1.0)[:, None]
    fingers = (contacts.point[:, 1:] * weight[..., None]).sum(axis=1) / total
    normal = (contacts.normal[:, 1:] * weight[..., None]).sum(axis=1) / total
    thumb, thumb_normal = contacts.point[:, 0], contacts.normal[:, 0]
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
class Evidence:
    """What speaks for N closed hands, each (N,).

    Attributes:
        enough: thumb and at least two fingers (or all the active ones) met something.
        opposition: of the normals at the thumb and the fingers, 1 = opposite.
        alignment: of the normals with the line between thumb and fingers, the worse of both sides.
        fingers: share of the five that met something.
        offset: distance of the pinch line to the middle of the shape between the fingers, horizontally [m].
        depth: of the contacts below the top of the shape [m].
        steep: 1 = straight down.
    """

    enough: Mask
    opposition: Array
    alignment: Array
    fingers: Array
    offset: Array
    depth: Array
    steep: Array

    def quality(self) -> Array:
        """(N,) in [`UNHELD`, 1]."""
        value = (
            0.30 * np.clip(self.opposition, 0, 1)
            + 0.25 * np.clip(self.alignment, 0, 1)
            + 0.15 * self.fingers
            + 0.15 * np.clip(1 - self.offset / 0.05, 0, 1)
            + 0.10 * np.clip(self.depth / 0.02, 0, 1)
            + 0.05 * np.clip(self.steep, 0, 1)
        )
        return np.where(self.enough, np.maximum(value, UNHELD), UNHELD)


def evidence(rotation: Array, contacts: Contacts, active: Mask, field: HeightField) -> Evidence:
    """The evidence of N hands.

    Args:
        rotation: (N, 3, 3) of `hand_tcp`, frame *table*.
        contacts: where their fingers touch.
        active: (N, 5) fingers that take part.
        field: what stands there.
    """
    found = pinch(contacts)
    middle = (found.fingers + found.thumb) / 2
    owner = field.owner.ravel()[field.cells(middle)]
    away = middle[:, :2] - field.centres[owner]
    flat = found.line[:, :2]
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)
    offset = np.abs(away[:, 0] * flat[:, 1] - away[:, 1] * flat[:, 0])
    return Evidence(
        enough=contacts.met[:, 0] & (found.others >= np.minimum(2, active[:, 1:].sum(axis=1))),
        opposition=found.opposition,
        alignment=np.minimum(found.thumb_alignment, found.finger_alignment),
        fingers=contacts.met.sum(axis=1) / 5,
        offset=np.where(owner > 0, offset, np.inf),
        depth=np.where(owner > 0, field.top(middle) - middle[:, 2], 0.0),
        steep=-rotation[:, 2, 2],
    )

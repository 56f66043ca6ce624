"""How likely a grasp holds: a logistic model of what is seen where the fingers would meet the cloud.

Its numbers, in `success.json`, are fitted to executed candidates by `dgs fit-success` (docs/ranking.md).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.closing import closed, closing_path
from dgs_grasp_planner.contact.height_field import CELL, HeightField
from dgs_grasp_planner.contact.quality import Contacts, contacts
from dgs_grasp_planner.way import free_way

FILE = Path(__file__).with_name("success.json")
EVIDENCE = (
    "free_way", "enough", "opposition", "thumb_alignment", "finger_alignment", "met", "active", "offset", "depth",
    "steep", "line_slope", "width", "middle_height", "hand_height", "off_across", "off_along", "length", "breadth",
    "top", "mean_height", "volume",
)  # fmt: skip
"""Columns of `evidence`."""
FAR = 0.1
"""A pinch line that passes the middle farther away is just as bad [m]."""
BAND = 0.03
"""Half of the strip along the pinch line in which a shape's breadth is measured [m]."""
MOST = 4.0
"""So many standard deviations count."""


def evidence(grasps: GraspSet, field: HeightField) -> Array:
    """(K, `EVIDENCE`) what speaks for and against K grasps: their contacts with the cloud, and the shape between.

    Lengths in metres, volume in litres; frame *table*.
    """
    path = closing_path(grasps)
    touched = closed(path, grasps.position, grasps.rotation, field)
    found = contacts(grasps.rotation, touched, path.active, field)
    held = found.pinch
    return np.column_stack(
        [
            free_way(grasps, field),
            found.enough,
            held.opposition,
            held.thumb_alignment,
            held.finger_alignment,
            touched.met.sum(axis=1),
            grasps.active_fingers.sum(axis=1),
            np.minimum(found.offset, FAR),
            found.depth,
            found.steep,
            np.abs(held.line[:, 2]),
            np.linalg.norm(held.fingers - held.thumb, axis=1),
            held.middle[:, 2],
            grasps.position[:, 2],
            _shapes(found, field),
        ]
    ).astype(np.float64)


def _shapes(found: Contacts, field: HeightField) -> Array:
    """(K, 7) of the shape between thumb and fingers: where its mass is, across and along the pinch line; length,
    breadth, top, mean height, volume. Zero where there is none."""
    owner, flat, middle = found.owner, found.pinch.level_line, found.pinch.middle
    out = np.zeros((len(owner), 7))
    for number in np.unique(owner[owner > 0]).tolist():
        shape = field.shapes[number]
        heights = shape.heights.astype(np.float64)
        mine = np.flatnonzero(owner == number)
        away = shape.points - middle[mine, None, :2]
        along = np.einsum("kci,ki->kc", away, flat[mine])
        across = np.einsum("kci,ki->kc", away, flat[mine][:, ::-1] * (-1, 1))
        share = heights / heights.sum()
        near = np.abs(across) < BAND
        breadth = np.where(near, along, -np.inf).max(axis=1) - np.where(near, along, np.inf).min(axis=1)
        out[mine] = np.column_stack(
            [
                np.abs(across @ share),
                along @ share,
                np.ptp(across, axis=1),
                np.where(near.any(axis=1), breadth, 0.0),
                np.tile([heights.max(), heights.mean(), 1e3 * heights.sum() * CELL**2], (len(mine), 1)),
            ]
        )
    return out


@dataclass(frozen=True)
class SuccessModel:
    """p = 1 / (1 + exp(-(bias + linear z + square (z^2 - 1)))), z = evidence in standard deviations from its mean.

    Attributes:
        mean, deviation: (F,) of the evidence.
        linear, square: (F,) weights.
        bias: for hardware as new.
    """

    mean: Array
    deviation: Array
    linear: Array
    square: Array
    bias: float

    def __call__(self, values: NDArray) -> Array:
        """(K,) probability that a grasp holds, by (K, F) evidence."""
        z = np.clip((values - self.mean) / self.deviation, -MOST, MOST)
        return np.asarray(1 / (1 + np.exp(-(self.bias + z @ self.linear + (z**2 - 1) @ self.square))))


@cache
def success_model() -> SuccessModel:
    """The model that ships."""
    data = json.loads(FILE.read_text(encoding="utf-8"))
    mean, deviation, linear, square = np.array([data["evidence"][name] for name in EVIDENCE]).T
    return SuccessModel(mean, deviation, linear, square, data["bias"])

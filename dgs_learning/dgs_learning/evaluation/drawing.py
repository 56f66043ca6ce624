"""Draws an attempt as a small SVG: the cloud, and the predicted hand as capsules and boxes, seen from a slant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from dgs_description.frames import apply, transform
from dgs_description.hand_model import PALM_BOXES, PHALANX_CAPSULES, TCP_IN_BASE, link_frames
from dgs_learning.evaluation.proposers.cloud_shape import OBJECT_HEIGHT
from dgs_learning.evaluation.protocol import AttemptRecord

Array = NDArray[np.float64]

SIZE = 300
"""Edge of the picture [px]."""
SPAN = 0.34
"""What the picture shows [m]."""
GOOD, BAD, PRE = "#0f8b8d", "#c8553d", "#8a8f98"
LEVELS = ("#b9c2cc", "#7fa3c7", "#4c7fb0", "#2f5d8c")
"""Colours of points: table, then higher and higher."""
HEIGHTS = (OBJECT_HEIGHT, 0.04, 0.08)
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


@dataclass(frozen=True)
class Viewpoint:
    """An orthographic view: `turn` (3, 3) has the picture's right, down and away as rows; `centre` is in its middle."""

    turn: Array
    centre: Array

    def project(self, points: Array) -> Array:
        """(..., 3) pixels right, pixels down, metres away of (..., 3) points."""
        seen = (np.asarray(points) - self.centre) @ self.turn.T
        seen[..., :2] = SIZE / 2 + seen[..., :2] * (SIZE / SPAN)
        return np.asarray(seen)


def viewpoint(centre: Array, azimuth: float, elevation: float = np.deg2rad(32.0)) -> Viewpoint:
    """Looking at `centre` (3,) from an azimuth and elevation [rad]."""
    towards = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return Viewpoint(np.stack([right, -np.cross(towards, right), -towards]), np.asarray(centre))


@dataclass(frozen=True)
class Mark:
    """A piece of SVG and how far away it is [m]."""

    away: float
    svg: str


def _capsules(view: Viewpoint, T_table_tcp: Array, joints: Array, colour: str, opacity: float) -> list[Mark]:
    """Phalanges: in an orthographic view a capsule is exactly a thick line with round ends."""
    marks = []
    for finger in link_frames(joints)[:, 1:]:
        for shape, T_tcp_link in zip(PHALANX_CAPSULES, finger, strict=True):
            ends = np.array([[0.0, y, shape.height] for y in (shape.start, shape.end)])
            (x1, y1, a1), (x2, y2, a2) = view.project(apply(T_table_tcp @ T_tcp_link, ends))
            wide = 2 * shape.radius * SIZE / SPAN
            line = f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}"'
            svg = (
                f'<g opacity="{opacity}">{line} stroke="#1d2733" stroke-width="{wide:.1f}"/>'
                f'{line} stroke="{colour}" stroke-width="{wide - 2:.1f}"/></g>'
            )
            marks.append(Mark(float(min(a1, a2)), svg))
    return marks


def _palm(view: Viewpoint, T_table_tcp: Array, colour: str, opacity: float) -> list[Mark]:
    marks = []
    for box in PALM_BOXES:
        low, high = box[0::2] - TCP_IN_BASE, box[1::2] - TCP_IN_BASE
        corners = view.project(apply(T_table_tcp, np.where(_CORNERS, high, low)))
        outline = corners[ConvexHull(corners[:, :2]).vertices, :2]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in outline)
        svg = f'<polygon points="{path}" fill="{colour}" stroke="#1d2733" opacity="{opacity}"/>'
        marks.append(Mark(float(corners[:, 2].mean()), svg))
    return marks


def _dots(view: Viewpoint, cloud: Array, depths: Array) -> list[Mark]:
    """Points, in bundles of one colour that stand between two marks of the hand."""
    seen = view.project(cloud)
    inside = ((seen[:, :2] > 0) & (seen[:, :2] < SIZE)).all(axis=1)
    seen, level = seen[inside], np.digitize(cloud[inside, 2], HEIGHTS)
    slot = np.digitize(seen[:, 2], depths)
    marks = []
    for key in np.unique(slot * len(LEVELS) + level):
        mine = seen[slot * len(LEVELS) + level == key]
        path = "".join(f"M{x:.0f} {y:.0f}h.1" for x, y, _ in mine)
        wide = 2 if key % len(LEVELS) == 0 else 4
        svg = f'<path d="{path}" stroke="{LEVELS[key % len(LEVELS)]}" stroke-width="{wide}"/>'
        marks.append(Mark(float(mine[:, 2].mean()), svg))
    return marks


def draw_attempt(attempt: AttemptRecord, cloud: Array) -> str:
    """SVG of an attempt: what the camera saw, the pre-grasp as a grey shade, the final hand in colour.

    Args:
        attempt: with or without a grasp.
        cloud: (N, 3) [m], frame *table*.
    """
    marks: list[Mark] = []
    if attempt.executed:
        T_table_tcp = transform(np.reshape(attempt.rotation, (3, 3)), attempt.position)
        # Across the pinch axis, from the side that looks down on the hand's back least.
        x = T_table_tcp[:3, 0]
        view = viewpoint(T_table_tcp[:3, 3] - 0.02 * T_table_tcp[:3, 2], np.arctan2(x[0], -x[1]) + 0.5)
        colour = GOOD if attempt.success else BAD
        marks += _palm(view, T_table_tcp, colour, 0.45)
        marks += _capsules(view, T_table_tcp, np.array(attempt.pre_grasp), PRE, 0.18)
        marks += _capsules(view, T_table_tcp, np.array(attempt.grasp), colour, 0.6)
    else:
        high = cloud[cloud[:, 2] > OBJECT_HEIGHT] if len(cloud) else cloud
        view = viewpoint(high.mean(axis=0) if len(high) else np.zeros(3), -1.0)
    if len(cloud):
        marks += _dots(view, cloud, np.sort([m.away for m in marks]))
    body = "".join(mark.svg for mark in sorted(marks, key=lambda m: -m.away))
    return (
        f'<svg viewBox="0 0 {SIZE} {SIZE}" role="img" fill="none" stroke-linecap="round" '
        f'aria-label="attempt {attempt.attempt} of scene {attempt.scene}">{body}</svg>'
    )

"""Triangle meshes of the hand in any posture, for pictures: palm boxes and phalanx capsules. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from dgs_description.frames import transform
from dgs_description.hand_model import PALM_BOXES, PHALANX_CAPSULES, TCP_IN_BASE, Capsule, link_frames
from dgs_sim_bridge.render.raster import Mesh

Array = NDArray[np.float64]

SECTORS = 32
"""Facets around a capsule."""
PALM_ROUNDING = 0.006
"""Edges of the palm are drawn rounded by this; the collision boxes are sharp [m]."""


@dataclass(frozen=True)
class HandPart:
    """A rigid piece of the hand.

    Attributes:
        mesh: in its own frame.
        T_tcp_part: (4, 4) pose.
        finger: 0..4, or -1 for the palm.
    """

    mesh: Mesh
    T_tcp_part: Array
    finger: int


def hand_parts(joints: Array) -> list[HandPart]:
    """All pieces of a hand with (20,) joints [rad]."""
    parts = [HandPart(mesh, transform(position=-TCP_IN_BASE), -1) for mesh in _palm()]
    frames = link_frames(joints)
    for finger in range(5):
        parts += [HandPart(mesh, frames[finger, k + 1], finger) for k, mesh in enumerate(_phalanges())]
    return parts


@cache
def _palm() -> tuple[Mesh, ...]:
    return tuple(_rounded_box(*box) for box in PALM_BOXES)


def _rounded_box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> Mesh:
    """Hull of eight small balls: a box with rounded edges and corners."""
    low, high = np.array([x0, y0, z0]), np.array([x1, y1, z1])
    ball = trimesh.creation.icosphere(subdivisions=2, radius=PALM_ROUNDING).vertices
    corners = low + PALM_ROUNDING + np.array(list(np.ndindex(2, 2, 2))) * (high - low - 2 * PALM_ROUNDING)
    hull = trimesh.Trimesh((corners[:, None] + ball).reshape(-1, 3)).convex_hull
    return np.asarray(hull.vertices), np.asarray(hull.faces)


@cache
def _phalanges() -> tuple[Mesh, ...]:
    return tuple(_capsule(shape) for shape in PHALANX_CAPSULES)


def _capsule(shape: Capsule) -> Mesh:
    """Hull of two balls on the axis (0, start..end, height) of the link's frame."""
    ball = trimesh.creation.uv_sphere(radius=shape.radius, count=[SECTORS // 2, SECTORS]).vertices
    ends = [ball + np.array([0.0, y, shape.height]) for y in (shape.start, shape.end)]
    hull = trimesh.Trimesh(np.concatenate(ends)).convex_hull
    return np.asarray(hull.vertices), np.asarray(hull.faces)

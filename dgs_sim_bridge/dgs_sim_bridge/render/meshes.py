"""Triangle meshes of cell and hand, made once from the description's primitives: for the camera and for pictures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from dgs_description.frames import Array, from_rpy, inverse
from dgs_description.hand import HAND
from dgs_description.urdf import cell
from dgs_description.urdf_parts import phalanx_shapes
from dgs_description.urdf_writer import Box, Cylinder, Shape
from dgs_sim_bridge.render.raster import Mesh

if TYPE_CHECKING:
    import trimesh

CELL_FACETS, HAND_FACETS = 16, 32
"""Facets around a capsule: coarse for the simulated camera, fine for pictures."""
PALM_ROUNDING = 0.006
"""Edges of the palm are drawn rounded by this; the collision boxes are sharp [m]."""


@dataclass(frozen=True)
class LinkMesh:
    """Shape of one link in its own frame.

    Attributes:
        link: name.
        mesh: vertices (V, 3) [m] and faces (F, 3), counter-clockwise from outside.
        colour: red, green, blue in 0..1.
    """

    link: str
    mesh: Mesh
    colour: tuple[float, float, float]


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


@cache
def link_meshes() -> tuple[LinkMesh, ...]:
    """Meshes of all links of the cell that have a shape, in the order of the URDF; slow the first time."""
    import trimesh  # slow to import, and not needed before the first picture

    return tuple(
        LinkMesh(link.name, _arrays(trimesh.util.concatenate([_mesh(s) for s in link.shapes])), link.colour)
        for link in cell().links
        if link.shapes
    )


def hand_parts(joints: Array) -> list[HandPart]:
    """All pieces of a hand with (J,) joints [rad]."""
    palm, phalanges = _hand_meshes()
    T_tcp_base = inverse(HAND.T_base_tcp)
    parts = [HandPart(mesh, T_tcp_base, -1) for mesh in palm]
    frames = HAND.link_frames(joints)
    for finger, meshes in enumerate(phalanges):
        parts += [HandPart(mesh, frames[finger, k + 1], finger) for k, mesh in enumerate(meshes)]
    return parts


@cache
def _hand_meshes() -> tuple[list[Mesh], list[list[Mesh]]]:
    """The palm's boxes, and the three phalanges of every finger."""
    fingers = [[_arrays(_mesh(shape, HAND_FACETS)) for shape in shapes] for shapes in phalanx_shapes()]
    return [rounded_box(box) for box in HAND.palm_boxes], fingers


def rounded_box(box: Array) -> Mesh:
    """The hull of eight small balls in the corners of a box (6,), x0 x1 y0 y1 z0 z1 [m]."""
    import trimesh

    low, high = box[0::2], box[1::2]
    radius = min(PALM_ROUNDING, float((high - low).min()) / 2)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=radius).vertices
    corners = low + radius + np.array(list(np.ndindex(2, 2, 2))) * (high - low - 2 * radius)
    return _arrays(trimesh.Trimesh((corners[:, None] + ball).reshape(-1, 3)).convex_hull)


def _mesh(shape: Shape, facets: int = CELL_FACETS) -> trimesh.Trimesh:
    import trimesh

    T_link_shape = from_rpy(shape.centre, shape.rpy)
    if isinstance(shape, Box):
        return trimesh.creation.box(extents=shape.size, transform=T_link_shape)
    if isinstance(shape, Cylinder):
        return trimesh.creation.cylinder(shape.radius, shape.length, sections=32, transform=T_link_shape)
    count = [3 * facets // 4, facets]
    return trimesh.creation.capsule(shape.length, shape.radius, count=count, transform=T_link_shape)


def _arrays(mesh: trimesh.Trimesh) -> Mesh:
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int32)

"""Triangle meshes of robot, hand, table, bin and stand for the camera, made once from the description's primitives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import from_rpy
from dgs_description.urdf import cell
from dgs_description.urdf_writer import Box, Cylinder, Shape

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class LinkMesh:
    """Shape of one link in its own frame.

    Attributes:
        link: name.
        vertices: (V, 3) [m].
        faces: (F, 3), counter-clockwise from outside.
        colour: red, green, blue in 0..1.
    """

    link: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colour: tuple[float, float, float]


@cache
def link_meshes() -> tuple[LinkMesh, ...]:
    """Meshes of all links of the cell that have a shape, in the order of the URDF; slow the first time."""
    import trimesh  # slow to import, and not needed before the first picture

    meshes = []
    for link in cell().links:
        if link.shapes:
            mesh = trimesh.util.concatenate([_mesh(shape) for shape in link.shapes])
            vertices = np.asarray(mesh.vertices, dtype=np.float64)
            meshes.append(LinkMesh(link.name, vertices, np.asarray(mesh.faces, dtype=np.int32), link.colour))
    return tuple(meshes)


def _mesh(shape: Shape) -> trimesh.Trimesh:
    import trimesh

    T_link_shape = from_rpy(shape.centre, shape.rpy)
    if isinstance(shape, Box):
        return trimesh.creation.box(extents=shape.size, transform=T_link_shape)
    if isinstance(shape, Cylinder):
        return trimesh.creation.cylinder(shape.radius, shape.length, sections=32, transform=T_link_shape)
    return trimesh.creation.capsule(shape.length, shape.radius, count=[12, 16], transform=T_link_shape)

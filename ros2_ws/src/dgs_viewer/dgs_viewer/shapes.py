"""Triangles of the robot's links and of whole hands, from the primitives of dgs_description."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array, from_rpy, inverse, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.hand_file import LINKS
from dgs_description.urdf_parts import palm_link, phalanx_shapes
from dgs_description.urdf_writer import Box, CapsuleShape, Cylinder, Shape

SECTIONS = 20
"""Corners of a circle."""
_SHARP = 0.6
"""Edges between faces that differ by more than this stay sharp [rad]."""


class Mesh(NamedTuple):
    """Vertices (V, 3) [m] and triangles (F, 3)."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.uint32]


class Instances(NamedTuple):
    """M copies of one mesh: positions (M, 3) [m] and unit quaternions wxyz (M, 4)."""

    positions: Array
    wxyz: Array


def mesh_of(shapes: tuple[Shape, ...] | list[Shape]) -> Mesh:
    """One mesh of some solid shapes, in their link's frame."""
    parts = [_solid(shape) for shape in shapes]
    whole = trimesh.graph.smooth_shade(trimesh.util.concatenate(parts), angle=_SHARP)
    return Mesh(np.asarray(whole.vertices, np.float32), np.asarray(whole.faces, np.uint32))


def _solid(shape: Shape) -> trimesh.Trimesh:
    match shape:
        case Box():
            solid = trimesh.creation.box(shape.size)
        case Cylinder():
            solid = trimesh.creation.cylinder(shape.radius, shape.length, sections=SECTIONS)
        case CapsuleShape():
            solid = trimesh.creation.capsule(shape.length, shape.radius, count=(SECTIONS // 2, SECTIONS))
    return solid.apply_transform(from_rpy(shape.centre, shape.rpy))


def hand_meshes() -> dict[str, Mesh]:
    """The shapes that a hand consists of: palm, and every finger's three phalanges."""
    names = ((f, link) for f in HAND.fingers for link in LINKS[1:])
    shapes = (shape for finger in phalanx_shapes() for shape in finger)
    phalanges = {f"{f}_{link}": mesh_of([shape]) for (f, link), shape in zip(names, shapes, strict=True)}
    return {"palm": mesh_of(palm_link().shapes), **phalanges}


def hand_instances(grasps: GraspSet, closed: float) -> dict[str, Instances]:
    """Where the parts of K hands are, in the grasps' frame; M = K of each part.

    Args:
        closed: 0 = pre-grasp shape where the approach ends, 1 = final shape after the grasp's motion.
    """
    joints = grasps.pre_grasp_joints + closed * (grasps.grasp_joints - grasps.pre_grasp_joints)
    T_frame_tcp = transform(grasps.rotation, grasps.position + closed * grasps.motion)
    palms = T_frame_tcp @ inverse(HAND.T_base_tcp)
    links = np.array([HAND.link_frames(q) for q in joints]).reshape(-1, *HAND.shape, 4, 4)
    fingers = T_frame_tcp[:, None, None] @ links
    return {
        "palm": instances(palms),
        **{
            f"{finger}_{link}": instances(fingers[:, f, k])
            for f, finger in enumerate(HAND.fingers)
            for k, link in enumerate(LINKS[1:], 1)
        },
    }


def instances(poses: Array) -> Instances:
    """Of poses (..., 4, 4)."""
    flat = poses.reshape(-1, 4, 4)
    return Instances(flat[:, :3, 3], Rotation.from_matrix(flat[:, :3, :3]).as_quat(scalar_first=True))

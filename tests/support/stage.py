"""A table with a few things in front of a D455: what tests of depth and infrared look at."""

from __future__ import annotations

import numpy as np

from dgs_description.frames import Array, look_at, transform
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.object_model import OPAQUE
from dgs_sim_bridge.render.raster import Mesh, box_mesh
from dgs_sim_bridge.render.shot import Stage

NO_NOISE = D455Noise(
    subpixel_rms=0,
    bias_rms=0,
    quantisation=0,
    edge_jitter=0,
    smeared=0,
    dropped=0,
    shadows=False,
    grazing_angle=0,
)
TABLE = box_mesh((-1.0, -1.0, -0.02), (1.0, 1.0, 0.0))
BOX = box_mesh((-0.05, -0.04, 0.0), (0.05, 0.04, 0.08))
PLACES = ((-0.12, -0.05), (0.12, -0.05), (0.0, 0.12))


def pillar(radius: float = 0.04, height: float = 0.10, sides: int = 40) -> Mesh:
    """A closed cylinder that stands on z = 0."""
    angle = np.arange(sides) * 2 * np.pi / sides
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (0.0, height))
    vertices = np.vstack([low, high, [(0, 0, 0), (0, 0, height)]])
    k, n = np.arange(sides), (np.arange(sides) + 1) % sides
    bottom, top = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    faces = [(k, n, n + sides), (k, n + sides, k + sides), (n, k, bottom), (k + sides, n + sides, top)]
    return vertices, np.vstack([np.column_stack(part) for part in faces]).astype(np.int32)


def table_stage(*materials: str) -> Stage:
    """A box, a pillar and a second box, of these materials, else opaque."""
    poses = [transform(position=(*place, 0.0)) for place in PLACES]
    given = (*materials, OPAQUE, OPAQUE, OPAQUE)[:3]
    return Stage([BOX, pillar(), BOX], np.array(poses), given, TABLE)


def camera_pose(elevation: float = 1.0, distance: float = 1.0) -> Array:
    """(4, 4) T_world_camera, looking at the middle of the table from -y [rad, m]."""
    direction = np.array([0.0, -np.cos(elevation), np.sin(elevation)])
    return look_at(distance * direction, np.zeros(3))

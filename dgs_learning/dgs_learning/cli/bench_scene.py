"""The scene of the speed measurement: always the same fifteen solids, through the depth camera's noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import apply, look_at, transform
from dgs_learning.objects import shapes
from dgs_learning.training.views import TABLE_MESH
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts
from dgs_sim_bridge.render.raster import render

_CAMERA = (0.42, 0.0, 0.74)
_SPOTS = [(x, y) for x in (-0.13, 0.0, 0.13) for y in (-0.30, -0.15, 0.0, 0.15, 0.30)]


def _solids() -> list[ObjectModel]:
    angles = np.linspace(0.15, np.pi - 0.15, 9)
    ball = [(0.038 * float(np.sin(a)), 0.038 - 0.038 * float(np.cos(a))) for a in angles]
    makes = (
        ("box", "cuboid", shapes.box([0.06, 0.07, 0.12])),
        ("can", "cylinder", shapes.lathe([(0.035, 0), (0.035, 0.12)])),
        ("ball", "sphere", shapes.lathe(ball)),
    )
    return [from_parts(name, kind, name, parts, 0.2) for name, kind, parts in makes]


def bench_scene() -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Points (N, 3) near the objects and the camera's position (3,), frame *table* [m]; always the same numbers."""
    solids = _solids()
    meshes, poses = [], []
    for k, (x, y) in enumerate(_SPOTS):
        model, turn = solids[k % len(solids)], 0.7 * k
        rotation = [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        meshes.append(model.mesh)
        poses.append(transform(rotation, (x, y, -float(model.vertices[:, 2].min()))))
    T_table_camera = look_at(_CAMERA, (0.0, 0.0, 0.05))
    depth = render(meshes, poses, D455, T_table_camera, table=TABLE_MESH).depth
    noisy = D455Noise().apply(depth, D455, np.random.default_rng(0))
    points = apply(T_table_camera, D455.deproject(noisy).astype(np.float64))
    inside = (np.abs(points[:, :2]) < 0.42).all(axis=1) & (points[:, 2] > -0.02) & (points[:, 2] < 0.3)
    return points[inside].astype(np.float32), T_table_camera[:3, 3]

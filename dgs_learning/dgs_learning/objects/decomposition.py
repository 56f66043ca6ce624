"""Convex parts of any mesh for contact: one hull where that fits, else CoACD (Wei et al., 2022)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DecompositionSettings:
    """How finely a mesh is cut.

    Attributes:
        single_hull: solidity from which the convex hull alone is good enough.
        threshold: concavity that is tolerated, relative to the mesh's size (CoACD's main knob).
        max_hulls, max_vertices: limits; PyBullet slows down beyond.
        seed: of CoACD's search.
    """

    single_hull: float = 0.93
    threshold: float = 0.05
    max_hulls: int = 16
    max_vertices: int = 64
    seed: int = 0


def convex_parts(mesh: trimesh.Trimesh, settings: DecompositionSettings | None = None) -> list[Array]:
    """Corners (V, 3) of each convex part [m]."""
    settings = settings or DecompositionSettings()
    hull = mesh.convex_hull
    if mesh.is_volume and mesh.volume / hull.volume >= settings.single_hull:
        return [_thinned(np.asarray(hull.vertices), settings.max_vertices)]
    import coacd  # a compiled library, needed for concave meshes only

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)),
        threshold=settings.threshold,
        max_convex_hull=settings.max_hulls,
        max_ch_vertex=settings.max_vertices,
        decimate=True,
        # A third of the default search takes a third of the time, and the parts' volume grew by 3 % (a ramekin).
        resolution=1000,
        mcts_iterations=60,
        mcts_nodes=10,
        mcts_max_depth=2,
        seed=settings.seed,
    )
    corners = [np.asarray(vertices, dtype=np.float64) for vertices, _ in parts]
    if volume_and_centre(corners)[0] >= settings.single_hull * hull.volume:
        corners = [np.asarray(hull.vertices)]  # the solidity of an open mesh is known only now
    return [_thinned(points, settings.max_vertices) for points in corners]


def _thinned(points: Array, count: int) -> Array:
    """At most `count` corners of the points' hull, by farthest-point sampling, so that the hull shrinks little."""
    corners = points[ConvexHull(points).vertices]
    if len(corners) <= count:
        return corners
    chosen = [int(np.argmax(np.linalg.norm(corners - corners.mean(0), axis=1)))]
    distance = np.linalg.norm(corners - corners[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(corners - corners[chosen[-1]], axis=1))
    return corners[np.sort(chosen)]


def volume_and_centre(parts: list[Array]) -> tuple[float, Array]:
    """Volume [m^3] and centre of mass (3,) [m] of convex parts, overlaps counted twice."""
    meshes = [trimesh.Trimesh(part).convex_hull for part in parts]
    volumes = np.array([m.volume for m in meshes])
    centres = np.array([m.center_mass for m in meshes])
    return float(volumes.sum()), (volumes[:, None] * centres).sum(0) / volumes.sum()

"""Convex parts of any mesh for contact: one hull where that fits, else CoACD (Wei et al., 2022)."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from dgs_description.frames import Array
from dgs_description.native import preload_libusb

SINGLE_HULL = 0.93
"""Solidity from which the convex hull alone is good enough."""
MAX_VERTICES = 64
"""Of a part; PyBullet slows down beyond."""


def convex_parts(mesh: trimesh.Trimesh, threshold: float, max_hulls: int) -> list[Array]:
    """Corners (V, 3) of each convex part [m].

    Args:
        threshold: concavity that is tolerated, relative to the mesh's size (CoACD's main knob).
        max_hulls: parts at most.
    """
    hull = mesh.convex_hull
    if mesh.is_volume and mesh.volume / hull.volume >= SINGLE_HULL:
        return [_thinned(np.asarray(hull.vertices))]
    import coacd  # a compiled library, needed for concave meshes only

    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)),
        threshold=threshold,
        max_convex_hull=max_hulls,
        max_ch_vertex=MAX_VERTICES,
        decimate=True,
        # A third of the default search takes a third of the time, and the parts' volume grew by 3 % (a ramekin).
        resolution=1000,
        mcts_iterations=60,
        mcts_nodes=10,
        mcts_max_depth=2,
        seed=0,
    )
    corners = [np.asarray(vertices, dtype=np.float64) for vertices, _ in parts]
    if volume_and_centre(corners)[0] >= SINGLE_HULL * hull.volume:
        corners = [np.asarray(hull.vertices)]  # the solidity of an open mesh is known only now
    return [_thinned(points) for points in corners]


def _thinned(points: Array) -> Array:
    """At most `MAX_VERTICES` corners of the points' hull, far from one another, so that the hull shrinks little."""
    corners = points[ConvexHull(points).vertices]
    if len(corners) <= MAX_VERTICES:
        return corners
    preload_libusb()
    import open3d as o3d  # a large library: only fine meshes need it

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(corners))
    return np.asarray(cloud.farthest_point_down_sample(MAX_VERTICES).points)


def volume_and_centre(parts: list[Array]) -> tuple[float, Array]:
    """Volume [m^3] and centre of mass (3,) [m] of convex parts, overlaps counted twice."""
    meshes = [trimesh.convex.convex_hull(part) for part in parts]
    volumes = np.array([m.volume for m in meshes])
    centres = np.array([m.center_mass for m in meshes])
    return float(volumes.sum()), (volumes[:, None] * centres).sum(0) / volumes.sum()

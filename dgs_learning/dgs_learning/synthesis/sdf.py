"""Signed distance of an object on a grid: what every kinematic test of the synthesis asks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import ConvexHull

from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.native import preload_libusb
from dgs_sim_bridge.render.object_model import ObjectModel


@dataclass(frozen=True)
class SignedDistance:
    """Signed distance [m], negative inside, tri-linear between grid nodes; beyond the grid a lower bound is extended.

    Attributes:
        origin: (3,) position of node (0, 0, 0).
        spacing: grid step [m].
        values: (X, Y, Z) float32.
    """

    origin: Array
    spacing: float
    values: NDArray[np.float32]

    def __call__(self, points: Array) -> Array:
        """(...) distances of (..., 3) points [m]."""
        index = (np.asarray(points) - self.origin) / self.spacing
        inside = np.clip(index, 0.0, np.array(self.values.shape) - 1.001)
        value = map_coordinates(
            self.values, inside.reshape(-1, 3).T, order=1, mode="nearest", prefilter=False, output=np.float32
        ).reshape(inside.shape[:-1])
        beyond = np.abs(index - inside).max(-1) * self.spacing
        return value + np.where(beyond > 0.01 * self.spacing, beyond, 0.0)

    @property
    def box(self) -> Array:
        """(2, 3) corners of the grid; nothing outside it is nearer to the object than the margin it was built with."""
        last = np.array(self.values.shape) - 1
        return np.stack([self.origin, self.origin + last * self.spacing])

    def clearance(self, spheres: NDArray) -> Array:
        """(..., S) distance of every sphere of a finger to the surface, centres (..., S, 3) [m]."""
        return self(spheres) - HAND.sphere_radii

    def normals(self, points: NDArray) -> Array:
        """(..., 3) unit outward normals by central differences over 2 mm."""
        offsets = 1e-3 * np.eye(3)
        difference = np.stack([self(points + d) - self(points - d) for d in offsets], -1)
        return difference / np.maximum(np.linalg.norm(difference, axis=-1, keepdims=True), 1e-9)


MARGIN = 0.018
"""The grid reaches so far beyond the object [m]: farther than the thickest sphere of a finger and a clearance."""


def surface_distance(vertices: NDArray, faces: NDArray, points: NDArray) -> NDArray[np.float32]:
    """(N,) unsigned distance of points (N, 3) to the surface of a mesh [m]."""
    preload_libusb()
    import open3d as o3d  # a large library: loaded where it is first needed

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners, query = (np.ascontiguousarray(array, dtype=np.float32) for array in (vertices, points))
    triangles = np.ascontiguousarray(faces, dtype=np.uint32)
    scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(triangles))
    return np.asarray(scene.compute_distance(o3d.core.Tensor(query), nthreads=1).numpy())


def signed_distance(model: ObjectModel, spacing: float = 0.0025) -> SignedDistance:
    """Build the grid of an object.

    The magnitude is the distance to the mesh (Open3D), the sign comes from the half spaces of the convex parts. Where
    the mesh is the parts' hulls, as in the catalogues, it is exact outside, also where parts overlap; of imported
    objects it jumps at the parts' surfaces by as much as these stand off the mesh.

    Args:
        model: the object.
        spacing: grid step [m]; 1.8 mm where there are more than eight parts.
    """
    if len(model.parts) > 8:
        spacing = 0.0018  # walls of a few millimetres
    low, high = (model.bounds.astype(np.float64) + np.array([[-MARGIN], [MARGIN]])).tolist()
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    points = grid.reshape(-1, 3)
    distance = surface_distance(model.vertices, model.faces, points)
    inside = np.zeros(len(points), dtype=bool)
    for part in model.parts:
        lower, upper = part.min(0), part.max(0)
        near = np.flatnonzero(((points >= lower) & (points <= upper)).all(1))
        equations = ConvexHull(part.astype(np.float64)).equations
        inside[near[(points[near] @ equations[:, :3].T + equations[:, 3] <= 0).all(1)]] = True
    values = np.where(inside, -distance, distance).astype(np.float32).reshape(grid.shape[:3])
    return SignedDistance(np.array([axis[0] for axis in axes]), spacing, values)


COARSE_SPACING = 0.004
"""Grid step of the distances to the other objects of a scene, unless they have many parts [m]."""
_coarse: dict[tuple[str, bytes], SignedDistance] = {}


def coarse_distance(model: ObjectModel) -> SignedDistance:
    """`signed_distance` on a grid of `COARSE_SPACING`, kept in memory: scenes meet the same objects again and again."""
    key = model.name, model.vertices.tobytes()
    if key not in _coarse:
        _coarse[key] = signed_distance(model, COARSE_SPACING)
    return _coarse[key]

"""Depth and instance images of triangle meshes by a z-buffer in numpy: for the simulator's camera and training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, apply, inverse

Mesh = tuple[NDArray, NDArray]
"""Vertices (V, 3) [m] and faces (F, 3), counter-clockwise from outside."""

NEAR = 0.05
"""From the camera's plane [m]."""
NOTHING = -1
TABLE = -2


@dataclass(frozen=True)
class Rendering:
    """What a camera without errors sees.

    Attributes:
        depth: (H, W) float32 z in the optical frame [m], 0 = nothing.
        ids: (H, W) int16 position of the mesh in the list, `TABLE` (-2) or `NOTHING` (-1).
        normals: (H, W, 3) float32 unit face normals in the optical frame, zero where nothing is; or None.
    """

    depth: NDArray[np.float32]
    ids: NDArray[np.int16]
    normals: NDArray[np.float32] | None = None


_BOX_FACES = np.array(
    [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4)]
    + [(1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)],
    dtype=np.int32,
)


def box_mesh(lower: ArrayLike, upper: ArrayLike) -> Mesh:
    """Mesh of the axis-aligned box between two corners (3,) [m]."""
    (x0, y0, z0), (x1, y1, z1) = np.asarray(lower, float), np.asarray(upper, float)
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    return np.array([(x, y, z) for z in (z0, z1) for x, y in corners]), _BOX_FACES


def render(
    meshes: Sequence[Mesh],
    poses: Sequence[NDArray] | NDArray,
    camera: PinholeCamera,
    T_world_camera: Array,
    *,
    table: Mesh | None = None,
    normals: bool = False,
) -> Rendering:
    """Render closed triangle meshes: of faces seen from behind, and of what is nearer than `NEAR`, nothing.

    Inverse depth is linear in the image, so every triangle is cut into one span per pixel row, and all spans of
    all triangles are filled at once.

    Args:
        poses: T_world_mesh (4, 4) per mesh.
        T_world_camera: (4, 4) pose of the optical frame (x right, y down, z forward).
        table: a mesh given in the world frame, reported as `TABLE`.

    Returns:
        The images.
    """
    corners, owner = _triangles_in_camera(meshes, poses, inverse(np.asarray(T_world_camera, float)), table)
    corners, owner = _clip_near(corners, owner)
    front = np.einsum("ij,ij->i", _normals(corners), corners[:, 0]) < 0
    corners, owner = corners[front], owner[front]
    winner, inverse_depth = _z_buffer(corners, camera)
    hit = winner >= 0
    depth = np.divide(1.0, inverse_depth, out=np.zeros_like(inverse_depth), where=hit)
    ids = np.full(winner.shape, NOTHING, dtype=np.int16)
    ids[hit] = owner[winner[hit]]
    image = (camera.height, camera.width)
    field = None
    if normals:
        field = np.zeros((*winner.shape, 3), dtype=np.float32)
        field[hit] = _unit_normals(corners)[winner[hit]]
        field = field.reshape(*image, 3)
    return Rendering(depth.reshape(image), ids.reshape(image), field)


def _triangles_in_camera(
    meshes: Sequence[Mesh], poses: Sequence[NDArray] | NDArray, T_camera_world: Array, table: Mesh | None
) -> tuple[Array, NDArray[np.int16]]:
    """All triangles (F, 3, 3) in the optical frame and the id of the mesh they belong to (F,)."""
    corners, owner = [np.zeros((0, 3, 3))], [np.zeros(0, dtype=np.int16)]
    placed = zip(meshes, poses, strict=True)
    items = [(mesh, T_camera_world @ pose, k) for k, (mesh, pose) in enumerate(placed)]
    if table is not None:
        items.append((table, T_camera_world, TABLE))
    for (vertices, faces), T_camera_mesh, k in items:
        corners.append(apply(T_camera_mesh, np.asarray(vertices, float))[faces])
        owner.append(np.full(len(faces), k, dtype=np.int16))
    return np.concatenate(corners), np.concatenate(owner)


def _clip_near(corners: Array, owner: NDArray[np.int16]) -> tuple[Array, NDArray[np.int16]]:
    """Cut triangles at the plane z = `NEAR`; what is in front of it stays as one or two triangles."""
    inside = corners[:, :, 2] > NEAR
    count = inside.sum(1)
    if (count == 3).all():
        return corners, owner
    pieces, owners = [corners[count == 3]], [owner[count == 3]]
    for kept in (1, 2):
        chosen = np.flatnonzero(count == kept)
        # Turn the triangle so that its odd corner (the only one inside, or the only one outside) comes first.
        odd = np.argmax(inside[chosen] == (kept == 1), axis=1)
        a, b, c = (corners[chosen, (odd + k) % 3] for k in range(3))
        ab = a + (b - a) * ((NEAR - a[:, 2]) / (b[:, 2] - a[:, 2]))[:, None]
        ac = a + (c - a) * ((NEAR - a[:, 2]) / (c[:, 2] - a[:, 2]))[:, None]
        parts = [(a, ab, ac)] if kept == 1 else [(ab, b, c), (ab, c, ac)]
        for part in parts:
            pieces.append(np.stack(part, axis=1))
            owners.append(owner[chosen])
    return np.concatenate(pieces), np.concatenate(owners)


def _normals(corners: Array) -> Array:
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _unit_normals(corners: Array) -> NDArray[np.float32]:
    normals = _normals(corners)
    return (normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)).astype(np.float32)


def _z_buffer(corners: Array, camera: PinholeCamera) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Index of the nearest triangle per pixel (-1 = none) and its inverse depth, both (H * W,)."""
    size = camera.width * camera.height
    winner, buffer = np.full(size, -1, dtype=np.int32), np.zeros(size, dtype=np.float32)
    triangle, row, first, count, start, gradient = _spans(corners, camera)
    total = int(count.sum())
    if total == 0:
        return winner, buffer
    # Pairs of a span and a pixel: `step` counts the pixels within the span.
    step = np.arange(total, dtype=np.int32) - np.repeat((np.cumsum(count) - count).astype(np.int32), count)
    pixel = step + np.repeat((row * camera.width + first).astype(np.int32), count)
    value = step.astype(np.float32)
    value *= np.repeat(gradient.astype(np.float32), count)
    value += np.repeat(start.astype(np.float32), count)
    np.maximum.at(buffer, pixel, value)
    nearest = np.flatnonzero(value == buffer[pixel])
    winner[pixel[nearest]] = np.repeat(triangle.astype(np.int32), count)[nearest]
    return winner, buffer


def _spans(corners: Array, camera: PinholeCamera) -> tuple[NDArray, ...]:
    """Cut triangles into pixel rows.

    Returns:
        Per span: triangle, row, first pixel, number of pixels, inverse depth at the first one, its step per pixel.
    """
    inverse_z = 1.0 / corners[:, :, 2]
    u = corners[:, :, 0] * inverse_z * camera.fx + camera.cx
    v = corners[:, :, 1] * inverse_z * camera.fy + camera.cy
    # Edge functions e_k = a_k u + b_k v + c_k of the edge opposite to corner k, positive inside; antisymmetric in
    # the edge's end points, so neighbouring triangles leave no gap.
    nxt, last = [1, 2, 0], [2, 0, 1]
    a, b = v[:, nxt] - v[:, last], u[:, last] - u[:, nxt]
    c = u[:, nxt] * v[:, last] - u[:, last] * v[:, nxt]
    area = c.sum(1)
    sign = np.sign(area)[:, None]
    a, b, c, area = a * sign, b * sign, c * sign, np.abs(area)
    top = np.clip(np.ceil(v.min(1)), 0, camera.height).astype(np.int64)
    bottom = np.clip(np.floor(v.max(1)), -1, camera.height - 1).astype(np.int64)
    rows = np.maximum(bottom - top + 1, 0)
    rows[(area < 1e-9) | (u.max(1) < 0) | (u.min(1) > camera.width - 1)] = 0

    triangle = np.repeat(np.arange(len(corners)), rows)
    row = np.arange(len(triangle)) - np.repeat(np.cumsum(rows) - rows, rows) + top[triangle]
    low, high = np.zeros(len(row)), np.full(len(row), camera.width - 1.0)
    for k in range(3):
        slope, rest = a[triangle, k], b[triangle, k] * row + c[triangle, k]
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = -rest / slope
        low = np.where((slope > 0) & (bound > low), bound, low)
        high = np.where((slope < 0) & (bound < high), bound, high)
    first, end = np.ceil(low).astype(np.int64), np.floor(high).astype(np.int64)
    filled = end >= first
    triangle, row, first, end = triangle[filled], row[filled], first[filled], end[filled]
    weights = inverse_z / np.maximum(area, 1e-30)[:, None]
    du, dv, constant = (a * weights).sum(1), (b * weights).sum(1), (c * weights).sum(1)
    start = du[triangle] * first + dv[triangle] * row + constant[triangle]
    return triangle, row, first, end - first + 1, start, du[triangle]

"""Infrared images of a scene as the D455's two imagers see it: shading, surface texture, the projector's dots, glass.

Glass shows what is behind it, shifted a little, and reflects its surroundings, more the flatter it is looked at
(Schlick's approximation of Fresnel's equations, 1994): its rims and highlights can be seen, its dots cannot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, inverse
from dgs_sim_bridge.render.d455 import Image
from dgs_sim_bridge.render.raster import Rendering

Picture = NDArray[np.uint8]

ALBEDO = (0.35, 0.9)
"""Of objects, drawn for each."""
TABLE_ALBEDO = 0.6
TEXTURE = 0.12
"""Relative contrast (rms) of a surface's texture of 2 mm grain."""
GRAIN = 0.002
AMBIENT, LASER = 1.0, 1.5
"""What a white surface at 1 m, seen face on, returns of room light and at a dot's centre; their ratio matters."""
EXPOSURE = 0.6
"""Automatic exposure brings the brightest twentieth of the image to this share of full scale."""
READ_NOISE = 0.006
"""Of full scale."""
SHADOW_GAP = 0.008
"""What lies so far behind the surface that the projector sees is in its shadow [m]."""
DOT_SPACING, DOT_SIGMA = 8.0, 0.9
"""Mean distance of the projector's dots, and their radius, in pixels of the camera."""
PROJECTOR_PLACE = 0.3
"""Of the projector on the way from the left to the right imager."""
NORMAL_REFLECTANCE = 0.04
"""Of glass seen face on, one surface: ((n - 1) / (n + 1))^2 for n = 1.5."""
REFRACTION = 9.0
"""Largest shift of the background seen through glass [px]."""
MIRROR_REFLECTANCE = 0.85
_OVERSAMPLING = 2
_LATTICE = 64


@dataclass(frozen=True)
class Light:
    """What the infrared images of one scene have in common: the same seed gives the same textures and lamps."""

    seed: int

    def albedo(self, count: int) -> NDArray[np.float32]:
        """(count + 2,): of every mesh, then of the table and of nothing, where negative ids look."""
        drawn = np.random.default_rng([self.seed, 1]).uniform(*ALBEDO, count)
        return np.array([*drawn, TABLE_ALBEDO, 0.0], dtype=np.float32)

    def lamps(self) -> Array:
        """(3, 3) unit directions towards lamps and windows, in the world (z up)."""
        rng = np.random.default_rng([self.seed, 2])
        azimuth, height = rng.uniform(-np.pi, np.pi, 3), rng.uniform(0.3, 1.2, 3)
        level = np.cos(height)
        return np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)])


@lru_cache(maxsize=2)
def dot_pattern(camera: PinholeCamera) -> Image:
    """The projector's pattern, `_OVERSAMPLING` times finer than the camera's pixels and half as large again."""
    width, height = (int(1.5 * size * _OVERSAMPLING) for size in (camera.width, camera.height))
    rng = np.random.default_rng(455)
    step = DOT_SPACING * _OVERSAMPLING
    v, u = np.mgrid[0 : height / step, 0 : width / step]
    dots = (np.stack([v, u]) + rng.uniform(0.0, 1.0, (2, *v.shape))) * step
    image = np.zeros((height, width), np.float32)
    v, u = (np.minimum(axis.astype(int), size - 1) for axis, size in zip(dots, image.shape, strict=True))
    image[v, u] = 1.0
    sigma = DOT_SIGMA * _OVERSAMPLING
    return np.minimum(gaussian_filter(image, sigma) * np.float32(2 * np.pi * sigma**2), np.float32(1.0))


@lru_cache(maxsize=1)
def _lattice() -> NDArray[np.float32]:
    return np.random.default_rng(456).standard_normal((_LATTICE,) * 3, dtype=np.float32)


def infrared_image(
    view: Rendering,
    poses: Array,
    camera: PinholeCamera,
    T_world_imager: Array,
    T_world_projector: Array,
    seen_by_projector: Image,
    light: Light,
) -> Image:
    """What opaque surfaces send back.

    Args:
        view: of the imager, with normals, opaque meshes only.
        poses: (N, 4, 4) T_world_mesh: textures move with their meshes.
        camera: of imager and projector.
        T_world_imager, T_world_projector: (4, 4) optical frames.
        seen_by_projector: (H, W) depth from there [m].

    Returns:
        (H, W) float32, 1 = a white surface at 1 m in the room's light.
    """
    assert view.normals is not None, "render with normals=True"
    v, u = np.nonzero(view.depth > 0)
    points = camera.deproject(view.depth)
    distance = np.linalg.norm(points, axis=1)
    ids, normals = view.ids[v, u], view.normals[v, u]
    facing = np.clip(-np.einsum("ij,ij->i", normals, points) / distance, 0.0, 1.0)
    albedo = light.albedo(len(poses))[ids] * _texture(points, ids, poses, T_world_imager)
    dots = _dots(points, camera, inverse(T_world_projector) @ T_world_imager, seen_by_projector)
    image = np.zeros(view.depth.shape, np.float32)
    image[v, u] = albedo * (AMBIENT * (0.4 + 0.6 * facing) + LASER * facing * dots / distance**2)
    return image


def _texture(points: NDArray, ids: NDArray, poses: Array, T_world_imager: Array) -> NDArray[np.float32]:
    """Factor on the albedo (M,) of a point's place in its mesh."""
    T_mesh_imager = np.array([*(inverse(np.asarray(pose)) for pose in poses), np.eye(4), np.eye(4)])
    T_mesh_imager = (T_mesh_imager @ T_world_imager).astype(np.float32)
    place = np.empty_like(points)
    for number in np.unique(ids):
        own = ids == number
        T = T_mesh_imager[number]
        place[own] = points[own] @ T[:3, :3].T + T[:3, 3]
    noise = map_coordinates(_lattice(), place.T / GRAIN, order=1, mode="grid-wrap")
    return np.clip(1.0 + 2.0 * TEXTURE * noise, 0.3, 1.7).astype(np.float32)


def _dots(
    points: NDArray, camera: PinholeCamera, T_projector_imager: Array, seen: Image
) -> NDArray[np.float32]:
    """(M,) the pattern's brightness on points in the imager's frame; 0 in the projector's shadow."""
    T = T_projector_imager.astype(np.float32)
    local = points @ T[:3, :3].T + T[:3, 3]
    u, v = camera.project(local).T
    column = np.clip(np.rint(u), 0, camera.width - 1).astype(int)
    row = np.clip(np.rint(v), 0, camera.height - 1).astype(int)
    lit = local[:, 2] < seen[row, column] + SHADOW_GAP
    place = np.stack([v + 0.25 * camera.height, u + 0.25 * camera.width]) * _OVERSAMPLING
    return map_coordinates(dot_pattern(camera), place, order=1, cval=0.0) * lit


def with_glass(
    image: Image,
    front: Rendering,
    glass: NDArray[np.bool_],
    mirror: NDArray[np.bool_],
    camera: PinholeCamera,
    T_world_imager: Array,
    light: Light,
) -> Image:
    """The image with the nearest glass and mirrors in front of what is opaque.

    Args:
        image: (H, W) of `infrared_image`.
        front: rendering of everything, with normals.
        glass, mirror: (N,) which meshes are.
        T_world_imager: (4, 4) its optical frame.
    """
    assert front.normals is not None, "render with normals=True"
    clear = np.concatenate([glass | mirror, [False, False]])[front.ids]
    v, u = np.nonzero(clear)
    rays = np.column_stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    normals = front.normals[v, u]
    cosine = np.clip(-np.einsum("ij,ij->i", normals, rays), 0.0, 1.0)
    one = NORMAL_REFLECTANCE + (1.0 - NORMAL_REFLECTANCE) * (1.0 - cosine) ** 5
    reflected = rays + 2.0 * cosine[:, None] * normals
    surroundings = _surroundings(reflected @ T_world_imager[:3, :3].T, light)
    # Front and back surface together; what leaves glass at a flat angle was bent away from what is behind.
    through, back = (1.0 - one) ** 2 * (0.5 + 0.5 * cosine), 2.0 * one / (1.0 + one)
    shifted = v + REFRACTION * normals[:, 1], u + REFRACTION * normals[:, 0]
    behind = map_coordinates(image, shifted, order=1, mode="nearest")
    silver = mirror[front.ids[v, u]]
    out = image.copy()
    out[v, u] = np.where(silver, MIRROR_REFLECTANCE * surroundings, through * behind + back * surroundings)
    return out


def _surroundings(directions: Array, light: Light) -> Array:
    """(M,) brightness of the room in directions (M, 3) of the world: a bright ceiling, a dark floor, lamps."""
    lamps = np.exp(60.0 * (directions @ light.lamps().T - 1.0)).sum(1)
    return 0.25 + 0.2 * directions[:, 2] + 1.5 * lamps


def expose(image: Image, rng: np.random.Generator) -> Picture:
    """8 bits of an image (H, W) of any brightness, with the imager's noise."""
    image = image * np.float32(EXPOSURE / max(float(np.quantile(image, 0.95)), 1e-6))
    noise = READ_NOISE * rng.standard_normal(image.shape, dtype=np.float32)
    return np.rint(255.0 * np.clip(image + noise, 0.0, 1.0)).astype(np.uint8)

"""A made-up table with boxes, balls and cans, for tests of the planner: a cloud in the table frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_grasp_planner.contact.height_field import HeightField, height_field

CAMERA = np.array([0.47, 0.0, 0.88])


def _box(rng: np.random.Generator, count: int) -> NDArray:
    size = rng.uniform((0.03, 0.03, 0.05), (0.08, 0.08, 0.14))
    points = rng.uniform(-0.5, 0.5, (count, 3))
    face = rng.integers(0, 3, count)
    points[np.arange(count), face] = np.sign(points[np.arange(count), face]) * 0.5
    return points * size + (0.0, 0.0, size[2] / 2)


def _ball(rng: np.random.Generator, count: int) -> NDArray:
    direction = rng.normal(size=(count, 3))
    radius = rng.uniform(0.03, 0.045)
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) * radius + (0.0, 0.0, radius)


def _can(rng: np.random.Generator, count: int) -> NDArray:
    radius, height = rng.uniform(0.02, 0.04), rng.uniform(0.07, 0.15)
    angle = rng.uniform(0, 2 * np.pi, count)
    top = rng.random(count) < 0.25
    r = np.where(top, radius * np.sqrt(rng.random(count)), radius)
    z = np.where(top, height, rng.random(count) * height)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], 1)


def table_scene(
    seed: int = 0, objects: int = 5, points_per_object: int = 2500, table_points: int = 20_000
) -> NDArray[np.float32]:
    """(N, 3) float32 [m]; with objects = 0 the bare table, with 1 mm of noise."""
    rng = np.random.default_rng(seed)
    table = np.column_stack(
        [rng.uniform((-0.2, -0.4), (0.2, 0.4), (table_points, 2)), 0.001 * rng.normal(size=table_points)]
    )
    spots = np.array([(x, y) for x in (-0.1, 0.1) for y in (-0.3, -0.15, 0.0, 0.15, 0.3)])
    parts = [table]
    for k, spot in enumerate(rng.permutation(spots)[:objects]):
        shape = (_box, _ball, _can)[k % 3](rng, points_per_object)
        parts.append(shape + (*spot, 0.0))
    return np.concatenate(parts).astype(np.float32)


def field_of(*clouds: ArrayLike, camera: NDArray | None = None, low: NDArray | None = None) -> HeightField:
    """What stands in clouds (N, 3) [m]; arguments of `height_field`."""
    field = height_field(np.concatenate(clouds), camera, low)
    assert field is not None
    return field

"""A made-up table with boxes, balls and cans, for tests of the planner: a cloud in the table frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

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


def on_table(*clouds: NDArray) -> NDArray[np.float32]:
    """Clouds (N, 3) of things, and the table beside them."""
    table, things = table_scene(objects=0), np.concatenate(clouds)
    beside = cKDTree(things[:, :2]).query(table[:, :2])[0] > 0.004
    return np.concatenate([things, table[beside]]).astype(np.float32)


def top(
    x: tuple[float, float], y: tuple[float, float], height: float, step: float = 0.0015
) -> NDArray[np.float64]:
    """(N, 3) the seen top of a block between two x and two y [m]."""
    u, v = np.meshgrid(np.arange(*x, step), np.arange(*y, step))
    return np.column_stack([u.ravel(), v.ravel(), np.full(u.size, height)])


def field_of(*clouds: ArrayLike, camera: NDArray | None = None, low: NDArray | None = None) -> HeightField:
    """What stands in clouds (N, 3) [m]; `low` may be a plate's floor, the rest is as in `height_field`."""
    return height_field(np.concatenate(clouds), camera, low, plates=low is not None)


def apart(*clouds: NDArray) -> HeightField:
    """What stands in clouds (N, 3) [m], each of which is known to be one thing."""
    field = field_of(*clouds)
    things, free = field.owner.copy(), int(field.owner.max()) + 1
    cells = np.argwhere(field.owner > 0)
    middles = field.middles(cells)
    nearest = np.argmin([cKDTree(cloud[:, :2]).query(middles)[0] for cloud in clouds], axis=0)
    for shape in np.unique(field.owner[field.owner > 0]):
        of_shape = field.owner[tuple(cells.T)] == shape
        for more, cloud in enumerate(np.unique(nearest[of_shape])):
            things[tuple(cells[of_shape & (nearest == cloud)].T)] = free if more else shape
            free += more > 0
    return replace(field, things=things)

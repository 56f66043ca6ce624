"""The table plane found in rendered scenes with the camera's noise, and refused where there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, apply, inverse, look_at, transform
from dgs_description.table_fit import (
    TablePlane,
    estimate_table,
    fit_plane,
    table_frame,
)
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import load_catalogue
from dgs_sim_bridge.render.raster import Mesh, box_mesh, render
from tests.support.refused import refused

CATALOGUE = load_catalogue(Path(__file__).resolve().parents[2] / "models" / "novel_objects.npz")
TABLE = box_mesh((-0.45, -0.6, -0.03), (0.45, 0.6, 0.0))
FLOOR = box_mesh((-3.0, -3.0, -0.8), (3.0, 3.0, -0.75))
WALL = box_mesh((-1.2, -3.0, -0.8), (-1.1, 3.0, 2.0))


def _camera(elevation_deg: float, azimuth_deg: float = 20.0, distance: float = 1.0) -> np.ndarray:
    elevation, azimuth = np.deg2rad(elevation_deg), np.deg2rad(azimuth_deg)
    eye = distance * np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return look_at(eye, (0.02, -0.03, 0.0))


def _objects(count: int, rng: np.random.Generator) -> list[tuple[Mesh, np.ndarray]]:
    """Objects standing on a 3 x 5 grid."""
    spots = np.array([(x, y) for x in (-0.15, 0.0, 0.15) for y in (-0.32, -0.16, 0.0, 0.16, 0.32)])
    out = []
    for spot, k in zip(rng.permutation(spots)[:count], rng.integers(0, len(CATALOGUE), count), strict=True):
        model = CATALOGUE[k]
        pose = transform(position=(*spot, -model.vertices[:, 2].min()))
        out.append((model.mesh, pose))
    return out


def _cloud(things: list[tuple[Mesh, np.ndarray]], T_table_camera: np.ndarray, seed: int) -> np.ndarray:
    """(N, 3) in the optical frame."""
    view = render([mesh for mesh, _ in things], [pose for _, pose in things], D455, T_table_camera)
    return D455.deproject(D455Noise().apply(view.depth, D455, np.random.default_rng(seed)))


def _check(cloud: np.ndarray, T_table_camera: np.ndarray) -> None:
    """The normal, and the height under the middle of the table."""
    plane = estimate_table(cloud, np.random.default_rng(0))
    normal = T_table_camera[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    middle = T_table_camera[:3, :3].T @ -T_table_camera[:3, 3]
    assert np.rad2deg(np.arccos(np.clip(plane.normal @ normal, -1, 1))) < 0.5
    assert abs(plane.heights(middle[None])[0]) < 3e-3


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("elevation", [25.0, 45.0, 70.0])
def test_cluttered_table_above_a_floor_with_a_wall(seed: int, elevation: float) -> None:
    rng = np.random.default_rng([seed, int(elevation)])
    T_table_camera = _camera(elevation, rng.uniform(-60, 60), rng.uniform(0.85, 1.15))
    surroundings = [(mesh, np.eye(4)) for mesh in (TABLE, FLOOR, WALL)]
    cloud = _cloud([*surroundings, *_objects(int(rng.integers(0, 16)), rng)], T_table_camera, seed)
    _check(cloud, T_table_camera)


@pytest.mark.parametrize("seed", range(3))
def test_objects_that_cover_half_of_the_view(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_table_camera = _camera(40.0, distance=0.75)
    blocks = [
        (box_mesh((-0.06, -0.07, 0.0), (0.06, 0.07, rng.uniform(0.05, 0.16))), transform(position=(x, y, 0)))
        for x in (-0.3, -0.1, 0.1, 0.25)
        for y in (-0.4, -0.2, 0.0, 0.2, 0.4)
    ]
    things = [(TABLE, np.eye(4)), *blocks]
    view = render([mesh for mesh, _ in things], [pose for _, pose in things], D455, T_table_camera)
    assert (view.ids > 0).sum() > 0.5 * (view.ids >= 0).sum(), "the objects cover more than the table"
    _check(_cloud(things, T_table_camera, seed), T_table_camera)


def test_a_large_box_is_an_object_and_not_the_table() -> None:
    T_table_camera = _camera(60.0)
    crate = box_mesh((-0.3, -0.35, 0.0), (0.3, 0.35, 0.12))
    _check(_cloud([(TABLE, np.eye(4)), (crate, np.eye(4))], T_table_camera, 0), T_table_camera)


def test_the_frame_stands_on_the_table_under_the_objects_and_looks_at_the_camera() -> None:
    T_table_camera = _camera(50.0)
    block = (box_mesh((-0.04, -0.04, 0.0), (0.04, 0.04, 0.1)), transform(position=(0.12, -0.2, 0.0)))
    cloud = _cloud([(TABLE, np.eye(4)), block], T_table_camera, 1)
    T_camera_table = table_frame(estimate_table(cloud, np.random.default_rng(0)), cloud)
    origin = apply(T_table_camera, T_camera_table[None, :3, 3])[0]
    np.testing.assert_allclose(origin[:2], (0.12, -0.2), atol=0.05)
    assert abs(origin[2]) < 3e-3
    camera = inverse(T_camera_table)[:3, 3]
    wanted = T_table_camera[:3, 3] - origin
    assert camera[2] == pytest.approx(wanted[2], abs=3e-3)
    assert np.hypot(camera[0], camera[1]) == pytest.approx(np.hypot(wanted[0], wanted[1]), abs=5e-3)
    assert camera[0] > 0.9 * np.hypot(camera[0], camera[1])
    np.testing.assert_allclose(T_camera_table[:3, :3].T @ T_camera_table[:3, :3], np.eye(3), atol=1e-9)


def test_seen_from_straight_above() -> None:
    T_table_camera = look_at((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), up=(-1, 0, 0))
    cloud = _cloud([(TABLE, np.eye(4))], T_table_camera, 0)
    _check(cloud, T_table_camera)
    T_camera_table = table_frame(estimate_table(cloud, np.random.default_rng(0)), cloud)
    assert np.linalg.det(T_camera_table[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("roll_deg", [90.0, 180.0, -135.0])
def test_a_rolled_camera_tells_the_table_from_the_wall(roll_deg: float) -> None:
    T_table_camera = _camera(35.0)
    T_table_camera[:3, :3] @= Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    surroundings = [(mesh, np.eye(4)) for mesh in (TABLE, FLOOR, WALL)]
    cloud = _cloud([*surroundings, *_objects(5, np.random.default_rng(1))], T_table_camera, 1)
    _check(cloud, T_table_camera)


@pytest.mark.parametrize("roll_deg", [0.0, 120.0])
def test_a_wrist_camera_close_above_a_corner_of_the_table(roll_deg: float) -> None:
    T_table_camera = look_at((0.35, 0.5, 0.42), (0.38, 0.52, 0.0), up=(1, 0, 0))
    T_table_camera[:3, :3] @= Rotation.from_euler("z", roll_deg, degrees=True).as_matrix()
    block = (box_mesh((-0.03, -0.04, 0.0), (0.03, 0.04, 0.06)), transform(position=(0.34, 0.45, 0.0)))
    _check(_cloud([(TABLE, np.eye(4)), (FLOOR, np.eye(4)), block], T_table_camera, 0), T_table_camera)


def test_the_same_seed_gives_the_same_plane() -> None:
    cloud = _cloud([(TABLE, np.eye(4))], _camera(45.0), 0)
    first, second = (estimate_table(cloud, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first.normal, second.normal)
    assert first.height == second.height


def _ball(rng: np.random.Generator) -> np.ndarray:
    points = rng.normal(size=(40_000, 3))
    return 0.3 * points / np.linalg.norm(points, axis=1, keepdims=True) + (0.0, 0.0, 1.0)


def _fog(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform((-0.4, -0.4, 0.5), (0.4, 0.4, 1.3), (40_000, 3))


def _heap_without_table(rng: np.random.Generator) -> np.ndarray:
    T_table_camera = _camera(45.0)
    return _cloud(_objects(12, rng), T_table_camera, 0)


@pytest.mark.parametrize("make", [_ball, _fog, _heap_without_table])
def test_no_table(make) -> None:
    with refused(ErrorCode.CLOUD_NO_TABLE, "no table found"):
        estimate_table(make(np.random.default_rng(0)), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("cloud", "code"),
    [
        (np.zeros((5, 2)), ErrorCode.CLOUD_FORMAT),
        (np.zeros((0, 3)), ErrorCode.CLOUD_EMPTY),
        (np.full((500, 3), np.nan), ErrorCode.CLOUD_EMPTY),
        (np.random.default_rng(0).uniform(400, 900, (5000, 3)), ErrorCode.CLOUD_EMPTY),  # millimetres
    ],
)
def test_clouds_that_are_none(cloud: np.ndarray, code: ErrorCode) -> None:
    with refused(code):
        estimate_table(cloud, np.random.default_rng(0))


@pytest.mark.parametrize("height", [0.015, -0.012])
@pytest.mark.parametrize(("tilt", "direction"), [(0.0, 0.0), (0.04, -0.5)])
def test_a_table_that_is_known_roughly_is_fitted_under_objects_and_noise(tilt, direction, height) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform((-0.2, -0.4), (0.2, 0.4), (20_000, 2)), np.zeros(20_000)])
    points[:, 2] = height - np.tan(tilt) * points[:, :2] @ (np.cos(direction), np.sin(direction)) - 0.2
    points[np.linalg.norm(points[:, :2] - (0.1, 0.2), axis=1) < 0.1, 2] += 0.05
    points[:, 2] += rng.normal(0, 0.002, len(points))
    plane = TablePlane(np.array([0.0, 0.0, 1.0]), 0.2, 0.0, 0.0)
    for tolerance in (0.03, OBJECT_HEIGHT):
        plane = fit_plane(points, plane, tolerance)
    assert np.arccos(min(plane.normal[2], 1.0)) == pytest.approx(tilt, abs=0.001)
    assert -plane.height / plane.normal[2] == pytest.approx(height - 0.2, abs=0.0005)
    assert 0.85 < plane.share < 0.95 and plane.rms == pytest.approx(0.002, abs=0.0003)

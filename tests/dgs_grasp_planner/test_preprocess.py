"""What of a cloud reaches the network."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.frames import OBJECT_HEIGHT
from dgs_grasp_planner.preprocess import CELL, TABLE_MARGIN, check_points, prepare_rows
from dgs_grasp_planner.scene import PlanRequest, prepare
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene
from tests.support.refused import refused


def _rows(points: np.ndarray, seed: int = 0, **limits: int) -> np.ndarray:
    return prepare_rows(points, np.random.default_rng(seed), **limits)


GOOD = np.ones((5, 3), np.float32)
SOME_BAD = np.concatenate([GOOD, np.full((1, 3), np.nan, np.float32)])


@pytest.mark.parametrize(
    ("points", "skip", "code"),
    [
        (np.zeros((0, 3)), True, ErrorCode.CLOUD_EMPTY),
        (np.zeros((5, 2)), True, ErrorCode.CLOUD_FORMAT),
        (np.zeros(3), True, ErrorCode.CLOUD_FORMAT),
        (SOME_BAD, False, ErrorCode.CLOUD_NOT_FINITE),
        (np.full((50, 3), np.nan), True, ErrorCode.CLOUD_NOT_FINITE),
        (np.full((50, 3), np.inf), True, ErrorCode.CLOUD_NOT_FINITE),
    ],
)
def test_what_is_no_cloud(points: np.ndarray, skip: bool, code: ErrorCode) -> None:
    with refused(code):
        check_points(points, skip)
    with refused(code):
        prepare(points[-1:], CAMERA, np.random.default_rng(0), PlanRequest())


def test_single_invalid_points_are_skipped() -> None:
    assert check_points(GOOD, False) is GOOD
    np.testing.assert_array_equal(check_points(SOME_BAD, True), GOOD)
    points = table_scene(1)
    points[::100] = np.nan
    scene = prepare(points, CAMERA, np.random.default_rng(0), PlanRequest())
    assert len(scene.points) and np.isfinite(scene.points).all()


def _noisy_table(noise: float) -> np.ndarray:
    points = table_scene(objects=0, table_points=60_000)
    points[:, 2] = np.random.default_rng(0).normal(0.0, noise, len(points))
    return points


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (table_scene(objects=0), ErrorCode.NO_OBJECTS),
        (_noisy_table(0.003), ErrorCode.NO_OBJECTS),
        (_noisy_table(0.006), ErrorCode.NO_OBJECTS),
        (np.array([[0.0, 0.0, 0.1]] * 20), ErrorCode.NO_OBJECTS),
        (np.array([[0.0, 0.0, -0.5]] * 100), ErrorCode.NO_OBJECTS),
        (np.array([[0.0, 0.0, 0.1], [900.0, 900.0, 0.1]] * 100), ErrorCode.CLOUD_FORMAT),
    ],
)
def test_bad_clouds(points: np.ndarray, code: ErrorCode) -> None:
    with refused(code):
        _rows(points)


@pytest.mark.parametrize("height", [0.009, 0.012])
def test_a_ruler_and_a_rod_under_noise_are_objects(height: float) -> None:
    rng = np.random.default_rng(1)
    points = table_scene(objects=0, table_points=60_000)
    ruler = rng.uniform((0.0, 0.0, height), (0.15, 0.02, height), (800, 3))
    points = np.concatenate([points, ruler])
    points[:, 2] += rng.normal(0.0, 0.002, len(points))
    rows = _rows(points)
    assert np.isin(np.flatnonzero(np.arange(len(points)) >= 60_000), rows).mean() > 0.9


def test_all_object_points_stay_and_far_table_goes() -> None:
    points = table_scene(1, objects=2)
    rows = _rows(points)
    kept = np.zeros(len(points), bool)
    kept[rows] = True
    high = points[:, 2] > OBJECT_HEIGHT
    assert kept[high].all()
    distance = np.linalg.norm(points[:, None, :2] - points[high][None, ::20, :2], axis=2).min(1)
    assert not kept[distance > TABLE_MARGIN + 2 * CELL * np.sqrt(2)].any()
    assert kept[distance < TABLE_MARGIN - 2 * CELL].all()


def test_the_paper_keeps_the_whole_table() -> None:
    points = table_scene(1, objects=2)
    holes = points[:100] - np.float32((0.0, 0.0, 0.3))
    rows = _rows(np.concatenate([points, holes]), keep_table=True, max_points=10**6)
    np.testing.assert_array_equal(rows, np.arange(len(points)))


def test_sampling_is_bounded_sorted_and_reproducible() -> None:
    points = table_scene(1)
    rows = _rows(points, max_points=1000)
    assert len(rows) == 1000
    assert (np.diff(rows) > 0).all()
    assert np.array_equal(rows, _rows(points, max_points=1000))
    assert not np.array_equal(rows, _rows(points, seed=1, max_points=1000))

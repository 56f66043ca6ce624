"""Clouds that show the table elsewhere, or nothing at all, are refused; those of a cell are levelled."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.frames import OBJECT_HEIGHT
from dgs_grasp_planner.scene import PlanRequest, prepare
from dgs_grasp_planner.table_seen import check_table, levelled
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene
from tests.support.refused import refused


def _prepare(points: np.ndarray) -> None:
    prepare(points.astype(np.float32), CAMERA, np.random.default_rng(0), PlanRequest())


def _refusal(points: np.ndarray) -> str:
    with refused(ErrorCode.CLOUD_NO_TABLE) as error:
        _prepare(points)
    return error.value.message


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("tilt", [0.2, 0.5, 0.8, 1.1])
def test_a_tilted_table(axis: str, tilt: float) -> None:
    turn = Rotation.from_euler(axis, tilt).as_matrix()
    said = _refusal(table_scene(1, objects=4) @ turn.T)
    assert any(f"tilted by {np.rad2deg(tilt) + off:.0f} " in said for off in (-2, -1, 0, 1, 2)), said


@pytest.mark.parametrize("shift", [0.05, 0.1, 0.2, -0.05, -0.1, -0.2, -0.5])
def test_a_table_that_is_higher_or_lower_than_it_should_be(shift: float) -> None:
    said = _refusal(table_scene(1, objects=4) + (0.0, 0.0, shift))
    assert shift < 0 or "mm above where the table should be" in said


@pytest.mark.parametrize(("depth", "words"), [(0.4, "fog"), (0.01, "neither the table nor things")])
def test_fog_and_a_wall_alone(depth: float, words: str) -> None:
    low, high = (-0.2, -0.4, 0.0), (depth - 0.2, 0.4, 0.3)
    assert words in _refusal(np.random.default_rng(0).uniform(low, high, (60_000, 3)))


def test_a_table_that_is_seen_too_thinly_is_not_called_empty() -> None:
    points = table_scene(objects=0)
    _, first = np.unique(np.floor(points[:, :2] / 0.02), axis=0, return_index=True)
    assert "thin the cloud" in _refusal(points[first])


def test_a_cloud_over_kilometres_is_refused_as_that() -> None:
    with refused(ErrorCode.CLOUD_FORMAT, "tens of metres"):
        _prepare(np.array([[0.0, 0.0, 0.1], [1e6, 1e6, 0.1]] * 100))


def test_what_is_at_the_camera_itself_says_nothing() -> None:
    eye, around = np.array([0.0, 0.0, 0.125]), np.random.default_rng(0).integers(-80, 80, (2500, 3)) / 4096
    check_table(eye + np.concatenate([around, -around]), eye)


def test_an_empty_table_is_empty() -> None:
    with refused(ErrorCode.NO_OBJECTS):
        _prepare(table_scene(objects=0))


@pytest.mark.parametrize("table_points", [0, 20_000])
def test_things_with_and_without_table_points_are_taken(table_points: int) -> None:
    _prepare(table_scene(1, objects=4, table_points=table_points))


def test_a_large_box_on_the_table_is_taken() -> None:
    rng = np.random.default_rng(0)
    lid = rng.uniform((-0.15, -0.35, 0.1), (0.15, 0.0, 0.1), (20_000, 3))
    table = table_scene(2, objects=3)
    _prepare(np.concatenate([table[(table[:, 1] > 0.0)], lid]))


def test_a_tilted_noisy_table_is_level_again_and_its_noise_no_object() -> None:
    rng = np.random.default_rng(2)
    points = table_scene(2, objects=2, table_points=60_000)
    tilted = points.astype(float)
    tilted[:, 2] += 0.004 + 0.017 * points[:, 0] - 0.01 * points[:, 1]
    level, heights = levelled(tilted, CAMERA)
    assert np.abs(level[:, 2] - points[:, 2]).max() < 1e-3 and (heights == np.float32(OBJECT_HEIGHT)).all()
    tilted[:, 2] += rng.normal(0.0, 0.005, len(points))
    level, heights = levelled(tilted, CAMERA)
    assert 0.014 < heights.min() < 0.020
    assert (level[20_000:60_000, 2] > heights[20_000:60_000]).mean() < 2e-3


def test_without_a_table_the_configured_pose_counts() -> None:
    objects = table_scene(2, objects=2, table_points=0)
    level, heights = levelled(objects, CAMERA)
    assert np.array_equal(level, objects) and (heights == np.float32(OBJECT_HEIGHT)).all()

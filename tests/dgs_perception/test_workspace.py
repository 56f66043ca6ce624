"""The crop to the workspace: geometry, order, counts, voxel filter."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from dgs_description.cell import CELL
from dgs_description.frames import apply, from_rpy, inverse
from dgs_perception.workspace import CropCounts, Workspace

BOX = Workspace(lower=(0.0, -1.0, -0.5), upper=(1.0, 1.0, 0.5))


def test_default_is_the_cell():
    lower, upper = CELL.cloud_bounds
    np.testing.assert_allclose(Workspace().lower, lower, atol=1e-9)
    np.testing.assert_allclose(Workspace().upper, upper, atol=1e-9)


def test_points_are_kept_exactly_where_the_box_is_and_keep_their_order():
    rng = np.random.default_rng(3)
    T_base_camera = from_rpy((0.7, -0.1, 0.9), (2.1, 0.3, -1.2))
    base = rng.uniform(-2, 2, (20_000, 3))
    expected = base[((base >= BOX.lower) & (base <= BOX.upper)).all(axis=1)]
    points, counts = BOX.crop(apply(inverse(T_base_camera), base), T_base_camera)
    assert points.dtype == np.float32 and points.flags.c_contiguous
    np.testing.assert_allclose(points, expected, atol=1e-6)
    assert counts == CropCounts(20_000, 0, 0, 20_000 - len(expected), 0, len(expected))


def test_borders_belong_to_the_box():
    corners = np.array([BOX.lower, BOX.upper])
    outside = corners + [[-1e-3, 0, 0], [0, 0, 1e-3]]
    points, _ = BOX.crop(np.vstack([corners, outside]), np.eye(4))
    np.testing.assert_array_equal(points, corners.astype(np.float32))


def test_every_reason_is_counted_once():
    nan, inf = np.nan, np.inf
    cloud = [
        [0.5, 0, 0.1],
        [nan, 0, 0],
        [nan, nan, nan],
        [0.5, -inf, 0],
        [inf, -inf, 0],
        [0, 0, 0],
        [-0.0, 0, 0],
        [5, 0, 0],
        [0.5, 0, 0],
    ]
    points, counts = BOX.crop(np.array(cloud, np.float32), np.eye(4))
    np.testing.assert_array_equal(points, np.array([[0.5, 0, 0.1], [0.5, 0, 0]], np.float32))
    assert counts == CropCounts(received=9, not_finite=4, zero=2, outside=1, merged=0, kept=2)


@pytest.mark.parametrize(
    "cloud", [np.empty((0, 3)), np.full((7, 3), np.nan), np.zeros((7, 3)), np.full((7, 3), 9.0)]
)
def test_nothing_left_is_an_empty_cloud(cloud):
    for voxel_size in (0.0, 0.01):
        points, counts = Workspace(voxel_size=voxel_size).crop(cloud, CELL.T_base_camera_optical)
        assert points.shape == (0, 3) and points.dtype == np.float32
        assert counts.kept == 0 and counts.received == len(cloud) == sum(astuple(counts)[1:])


def test_voxels_hold_the_mean_of_their_points_in_a_stable_order():
    rng = np.random.default_rng(4)
    centres = np.array([[0.105, 0.305, 0.105], [0.505, -0.395, 0.205], [0.055, 0.105, 0.105]])
    cloud = np.repeat(centres, 40, axis=0) + rng.uniform(-0.004, 0.004, (120, 3))
    means = cloud.reshape(3, 40, 3).mean(axis=1)
    box = Workspace(BOX.lower, BOX.upper, voxel_size=0.05)
    first, counts = box.crop(cloud, np.eye(4))
    again, _ = box.crop(rng.permutation(cloud), np.eye(4))
    np.testing.assert_allclose(first, means[[2, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(again, first, atol=1e-6)
    assert counts == CropCounts(received=120, not_finite=0, zero=0, outside=0, merged=117, kept=3)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"lower": (0, 0, 0), "upper": (1, 0, 1)}, "lower < upper"),
        ({"lower": (0, 0, float("nan")), "upper": (1, 1, 1)}, "lower < upper"),
        ({"lower": (0, 0)}, "lower < upper"),
        ({"voxel_size": -0.01}, "voxel size"),
        ({"voxel_size": float("nan")}, "voxel size"),
    ],
)
def test_impossible_boxes_are_refused(values, sentence):
    with pytest.raises(ValueError, match=sentence):
        Workspace(**values)

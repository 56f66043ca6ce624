"""The crop to the workspace: geometry, order, counts."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from dgs_description.cell import CELL
from dgs_description.frames import apply, from_rpy, inverse
from dgs_perception.workspace import CropCounts, crop

BOX = np.array([[0.0, -1.0, -0.5], [1.0, 1.0, 0.5]])


def test_points_are_kept_exactly_where_the_box_is_and_keep_their_order():
    rng = np.random.default_rng(3)
    T_base_camera = from_rpy((0.7, -0.1, 0.9), (2.1, 0.3, -1.2))
    base = rng.uniform(-2, 2, (20_000, 3))
    expected = base[((base >= BOX[0]) & (base <= BOX[1])).all(axis=1)]
    points, counts = crop(apply(inverse(T_base_camera), base), T_base_camera, *BOX)
    assert points.dtype == np.float32 and points.flags.c_contiguous
    np.testing.assert_allclose(points, expected, atol=1e-6)
    assert counts == CropCounts(20_000, 0, 0, 20_000 - len(expected), len(expected))


def test_borders_belong_to_the_box():
    corners = BOX
    outside = corners + [[-1e-3, 0, 0], [0, 0, 1e-3]]
    points, _ = crop(np.vstack([corners, outside]), np.eye(4), *BOX)
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
    points, counts = crop(np.array(cloud, np.float32), np.eye(4), *BOX)
    np.testing.assert_array_equal(points, np.array([[0.5, 0, 0.1], [0.5, 0, 0]], np.float32))
    assert counts == CropCounts(received=9, not_finite=4, zero=2, outside=1, kept=2)


@pytest.mark.parametrize(
    "cloud", [np.empty((0, 3)), np.full((7, 3), np.nan), np.zeros((7, 3)), np.full((7, 3), 9.0)]
)
def test_nothing_left_is_an_empty_cloud(cloud):
    points, counts = crop(cloud, CELL.T_base_camera_optical, *CELL.cloud_bounds)
    assert points.shape == (0, 3) and points.dtype == np.float32
    assert counts.kept == 0 and counts.received == len(cloud) == sum(astuple(counts)[1:])

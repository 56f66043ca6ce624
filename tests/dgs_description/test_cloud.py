"""Cells of bare clouds, and what belongs together."""

from __future__ import annotations

import numpy as np

from dgs_description.cloud import connected, squares, voxel_means


def test_voxel_means_come_in_a_stable_order() -> None:
    points = np.array([(0.031, 0.0, 0.0), (0.001, 0.001, 0.001), (0.003, 0.003, 0.003), (-0.001, 0.0, 0.0)])
    means = [(-0.001, 0.0, 0.0), (0.002, 0.002, 0.002), (0.031, 0.0, 0.0)]
    np.testing.assert_allclose(voxel_means(points, 0.01), means)
    np.testing.assert_array_equal(voxel_means(points[::-1], 0.01), voxel_means(points, 0.01))
    assert voxel_means(np.zeros((0, 3)), 0.01).shape == (0, 3)


def test_cubes_are_the_same_whether_counted_or_sorted() -> None:
    near = np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 3))
    with_one_far = np.vstack([near, np.full((1, 3), 50.0)])  # so many cubes in between are not counted
    assert np.array_equal(voxel_means(with_one_far, 0.02)[:-1], voxel_means(near, 0.02))
    assert np.array_equal(squares(with_one_far[:, :2], 0.02)[:-1], squares(near[:, :2], 0.02))
    wild = np.vstack([near[:, :2], np.full((1, 2), 1e300)])
    assert np.array_equal(squares(wild, 0.02)[:-1], squares(near[:, :2], 0.02))


def test_chains_of_near_points_are_one_thing() -> None:
    chain = np.column_stack([0.009 * np.arange(10), np.zeros((10, 2))])
    apart = chain + (0.0, 0.011, 0.0)
    number = connected(np.concatenate([chain, apart]), 0.010)
    assert len(set(number[:10])) == len(set(number[10:])) == 1 and number[0] != number[10]
    assert len(set(connected(np.concatenate([chain, apart]), 0.012))) == 1
    assert connected(np.zeros((0, 3)), 0.01).shape == (0,)

"""What lies flat is seen whole, and the table and the feet of other things stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from dgs_description.frames import OBJECT_HEIGHT
from dgs_grasp_planner.low_things import low_things

NOISE = 0.0015
"""Standard deviation of a height [m]."""


def cloud(*boxes: tuple[float, float, float, float, float], seed: int = 0) -> NDArray[np.float32]:
    """A noisy table of 0.5 x 0.5 m with boxes (x, y, width, depth, height) on it: a point every 2 mm."""
    rng = np.random.default_rng(seed)
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-0.25, 0.25, 0.002)] * 2, indexing="ij"))
    z = np.zeros(len(x))
    for left, front, width, depth, height in boxes:
        z[(x > left) & (x < left + width) & (y > front) & (y < front + depth)] = height
    return np.column_stack([x, y, z + rng.normal(0.0, NOISE, len(z))]).astype(np.float32)


def inside(
    points: NDArray, box: tuple[float, float, float, float, float], margin: float
) -> NDArray[np.bool_]:
    left, front, width, depth, _ = box
    x, y = points[:, 0], points[:, 1]
    return np.asarray(
        (x > left - margin)
        & (x < left + width + margin)
        & (y > front - margin)
        & (y < front + depth + margin)
    )


def usual(points: NDArray) -> NDArray[np.float32]:
    return np.full(len(points), OBJECT_HEIGHT, dtype=np.float32)


@pytest.mark.parametrize("height", [0.006, 0.007])
def test_a_mat_is_seen_whole(height: float) -> None:
    mat = (-0.1, -0.08, 0.2, 0.15, height)
    points = cloud(mat)
    least, on_it = usual(points), inside(points, mat, -0.004)
    assert (points[on_it, 2] > least[on_it]).mean() < 0.3
    found = low_things(points, least)
    assert (points[on_it, 2] > found[on_it]).mean() > 0.95
    beyond = ~inside(points, mat, 0.01)
    np.testing.assert_array_equal(found[beyond], least[beyond])


def test_the_table_and_the_foot_of_a_box_stay_as_they_are() -> None:
    points = cloud((0.0, 0.0, 0.08, 0.06, 0.05))
    np.testing.assert_array_equal(low_things(points, usual(points)), usual(points))
    bare = cloud()
    np.testing.assert_array_equal(low_things(bare, usual(bare)), usual(bare))


def test_what_is_nowhere_higher_than_the_noise_is_table() -> None:
    """A board of 3 mm is a table that is 3 mm too high, for all that one can see."""
    points, spikes = cloud((-0.1, -0.1, 0.2, 0.2, 0.003)), cloud()
    spikes[[row + column for row in range(0, 60_000, 5000) for column in (1, 2)], 2] = 0.009
    for each in (points, spikes):
        np.testing.assert_array_equal(low_things(each, usual(each)), usual(each))


def test_odd_clouds_are_left_alone() -> None:
    for points in (np.zeros((0, 3)), np.array([[0, 0, 0.01], [1e6, 0, 0]])):
        least = np.full(len(points), OBJECT_HEIGHT, np.float32)
        assert low_things(points.astype(np.float32), least) is least

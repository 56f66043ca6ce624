from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.paths import plan_path, rrt_connect
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene
from dgs_description.cell import HOME_ARM
from dgs_description.joints import ARM_LOWER, ARM_UPPER

OPEN = np.zeros(20)
LEFT = np.array([0.9, -1.1, 1.7, -2.1, -1.57, 0.0])
RIGHT = np.array([-1.4, -1.1, 1.7, -2.1, -1.57, 0.0])


@pytest.fixture(scope="module")
def walled() -> CollisionChecker:
    """A wall across the table between the two postures, too high to pass at their height."""
    wall = np.random.default_rng(0).uniform((-0.6, -0.01, -0.2), (-0.1, 0.01, 0.02), (60000, 3))
    wall = np.concatenate([wall, wall * (-1, 1, 1)])
    return PlanningScene(ObstacleCloud.from_points(wall)).checker(OPEN)


def test_the_straight_line_is_taken_where_it_is_free() -> None:
    checker = PlanningScene().checker(OPEN)
    path = plan_path(checker, LEFT, RIGHT, 1.0)
    assert path is not None
    assert path.length == pytest.approx(np.linalg.norm(RIGHT - LEFT))
    assert path.is_straight.all()


def test_a_way_around_is_found_and_is_free_on_its_rounded_corners(
    walled: CollisionChecker, ik: ArmIK
) -> None:
    assert not walled.in_collision(LEFT) and not walled.in_collision(RIGHT)
    assert walled.first_collision(np.stack([LEFT, RIGHT])) is not None
    path = plan_path(walled, LEFT, RIGHT, 20.0)
    assert path is not None
    np.testing.assert_allclose(path(0.0), LEFT, atol=1e-9)
    np.testing.assert_allclose(path(path.length), RIGHT, atol=1e-9)
    assert not any(walled.in_collision(q) for q in path(np.linspace(0, path.length, 500)))
    assert path.length < 3 * np.linalg.norm(RIGHT - LEFT)


def test_no_way_is_none_within_the_time(walled: CollisionChecker) -> None:
    blocked = next(q for q in np.linspace(LEFT, RIGHT, 200) if walled.in_collision(q))
    assert plan_path(walled, LEFT, blocked, 0.2) is None


def test_a_path_that_grazes_something_between_its_states_is_not_the_end_of_the_search() -> None:
    over_the_bin = np.array([-1.95, -0.95, 1.01, -1.63, -1.57, 0.14])
    beside_it = np.random.default_rng(0).uniform((-0.049, -0.398, 0.0), (-0.012, -0.381, 0.083), (20000, 3))
    checker = PlanningScene(ObstacleCloud.from_points(beside_it)).checker(OPEN)
    assert not checker.in_collision(over_the_bin)
    assert all(plan_path(checker, over_the_bin, HOME_ARM, 0.6) is not None for _ in range(100))


class Islands(CollisionChecker):
    """Free near the two postures and nowhere else."""

    def __init__(self) -> None:
        self.checks = 0
        self.lower, self.upper = ARM_LOWER, ARM_UPPER

    def in_collision(self, q: ArrayLike) -> bool:
        self.checks += 1
        return min(np.abs(np.asarray(q) - island).max() for island in (LEFT, RIGHT)) > 0.05


def test_a_query_that_cannot_succeed_ends_in_time() -> None:
    islands, began = Islands(), time.thread_time()
    assert plan_path(islands, LEFT, RIGHT, 0.2) is None
    assert islands.checks > 100 and time.thread_time() - began < 1.0


def test_what_the_search_finds_is_simplified(walled: CollisionChecker) -> None:
    found = rrt_connect(walled, LEFT, RIGHT, timeout=20.0, tuned=True)
    assert found is not None and len(found) < 12
    np.testing.assert_allclose(found[[0, -1]], [LEFT, RIGHT])
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).sum() < 2 * np.linalg.norm(RIGHT - LEFT)

"""Things of a height field as solid bodies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from dgs_grasp_planner.believed import DENSITY, solid
from dgs_grasp_planner.contact.things import CELL
from tests.dgs_grasp_planner.scenes import field_of

LENGTH, WIDTH, HEIGHT = 0.12, 0.06, 0.08


def top(low: tuple[float, float], high: tuple[float, float], height: float) -> np.ndarray:
    """The seen top of a box between two corners."""
    x, y = (np.arange(a, b + 1e-9, 0.001) for a, b in zip(low, high, strict=True))
    x, y = np.meshgrid(x, y)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])


BOX = top((0.0, 0.0), (LENGTH, WIDTH), HEIGHT)


def test_a_box_is_one_part_of_its_size_around_its_middle() -> None:
    found = solid(field_of(BOX), 1)
    assert found is not None
    body, pose = found
    assert len(body.parts) == 1
    np.testing.assert_allclose(np.ptp(body.parts[0], axis=0), (LENGTH, WIDTH, HEIGHT), atol=1.5 * CELL)
    np.testing.assert_allclose(pose[:3, 3], (LENGTH / 2, WIDTH / 2, HEIGHT / 2), atol=CELL)
    assert body.mass == pytest.approx(DENSITY * LENGTH * WIDTH * HEIGHT, rel=0.1)


def test_what_is_not_convex_is_cut() -> None:
    field = field_of(BOX, top((0.0, 0.0), (0.03, 0.16), HEIGHT))
    found = solid(field, 1)
    assert found is not None
    parts = found[0].parts
    volume = sum(ConvexHull(part).volume for part in parts)
    whole = float(field.heights[field.owner == 1].sum() * CELL**2)
    assert len(parts) >= 2 and whole <= volume < 1.15 * whole
    assert ConvexHull(np.concatenate(parts)).volume > 1.2 * whole


def test_a_tower_on_a_plate_is_cut_where_the_height_steps() -> None:
    found = solid(field_of(top((0.0, 0.0), (0.12, 0.06), 0.02), top((0.08, 0.0), (0.12, 0.06), 0.1)), 1)
    assert found is not None
    body, pose = found
    assert len(body.parts) >= 2
    tops = [part[:, 2].max() + pose[2, 3] for part in body.parts]
    assert min(tops) == pytest.approx(0.02, abs=0.002) and max(tops) == pytest.approx(0.1, abs=0.002)

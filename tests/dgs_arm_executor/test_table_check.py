"""Tilt and height error of a table under objects and noise."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_arm_executor.table_check import fit_table
from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from tests.support.refused import refused


def cloud(tilt: float = 0.0, direction: float = 0.0, height: float = 0.0, noise: float = 0.002) -> np.ndarray:
    """A table with ten objects, cropped as the camera node does it; it falls towards `direction`."""
    rng = np.random.default_rng(0)
    lower, upper = CELL.workspace_bounds
    points = np.column_stack([rng.uniform(lower[:2], upper[:2], (60_000, 2)), np.zeros(60_000)])
    away = points[:, :2] - CELL.workspace_centre
    points[:, 2] = CELL.table_height + height - np.tan(tilt) * away @ (np.cos(direction), np.sin(direction))
    for _ in range(10):
        centre = rng.uniform(lower[:2], upper[:2])
        points[np.linalg.norm(points[:, :2] - centre, axis=1) < 0.04, 2] += rng.uniform(0.03, 0.1)
    points[:, 2] += rng.normal(0, noise, len(points))
    return points[(points[:, 2] > lower[2]) & (points[:, 2] < upper[2])]


@pytest.mark.parametrize("height", [0.0, 0.015, -0.012])
@pytest.mark.parametrize(("tilt", "direction"), [(0.0, 0.0), (0.015, 2.0), (0.04, -0.5)])
def test_tilt_and_height_are_measured(tilt: float, direction: float, height: float) -> None:
    fit = fit_table(cloud(tilt, direction, height))
    assert fit.tilt == pytest.approx(tilt, abs=0.002)
    assert fit.height == pytest.approx(height, abs=0.0015)
    if tilt:
        assert fit.direction == pytest.approx(direction, abs=0.05)
    assert 0.3 < fit.seen <= 1.05 and 0.001 < fit.rms < 0.003


def test_what_lies_beside_the_workspace_does_not_count() -> None:
    table, low = cloud(), CELL.workspace_bounds[0]
    shelf = np.random.default_rng(2).uniform(low - (0.15, 0.0, 0.0), low + (-0.01, 0.8, 0.01), (40_000, 3))
    assert fit_table(np.concatenate([table, shelf])) == fit_table(table)


@pytest.mark.parametrize(
    ("tilt", "height", "right"),
    [(0.0, 0.0, True), (0.01, 0.006, True), (0.03, 0.0, False), (0.0, -0.014, False)],
)
def test_bounds(tilt: float, height: float, right: bool) -> None:
    fit = fit_table(cloud(tilt, 1.0, height))
    if right:
        fit.check()
        return
    with refused(ErrorCode.EXTRINSICS_OFF, "deg.* mm"):
        fit.check()


def test_no_table_is_off_as_well() -> None:
    rng = np.random.default_rng(1)
    heap = rng.uniform((0.1, -0.4, -0.2), (0.5, 0.4, 0.1), (20_000, 3))
    for points in (np.zeros((0, 3)), cloud()[:500], np.full((5000, 3), np.nan), heap, cloud(height=-0.05)):
        with refused(ErrorCode.EXTRINSICS_OFF, "no table"):
            fit_table(points)

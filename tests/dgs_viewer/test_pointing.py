"""From a place on the screen to an object."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.cell import CELL
from dgs_viewer.pointing import MARGIN, ScreenCamera, above_table, box_around, hit, in_rectangle, object_at

TOP = CELL.table_height


def block(x: float, y: float, size: float = 0.04, step: float = 0.005) -> np.ndarray:
    """Points of a cube that stands on the table at x, y."""
    side = np.arange(0.0, size + 1e-9, step)
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    return grid + (x - size / 2, y - size / 2, TOP)


TABLE = np.array([(x, y, TOP) for x in np.arange(0.1, 0.5, 0.01) for y in np.arange(-0.4, 0.4, 0.01)])
NEAR, FAR = block(0.25, -0.1), block(0.25, 0.1)
POINTS = np.concatenate([TABLE, NEAR, FAR])
EYE = np.array([1.0, -0.1, 0.5])


@pytest.mark.parametrize("centre", [(0.25, -0.1), (0.25, 0.1)])
def test_a_click_finds_the_whole_object_and_no_more(centre):
    aim = np.array([*centre, TOP + 0.03])
    index = hit(POINTS, EYE, aim - EYE)
    assert index is not None
    found = POINTS[object_at(POINTS, index)]
    np.testing.assert_allclose(found[:, :2].mean(axis=0), centre, atol=0.002)
    assert len(found) == above_table(NEAR).sum()


def test_what_stands_in_front_is_hit():
    behind = NEAR.mean(axis=0)
    start = FAR.mean(axis=0) + (FAR.mean(axis=0) - behind)
    index = hit(POINTS, start, behind - start)
    assert index is not None
    assert POINTS[index, 1] > 0


@pytest.mark.parametrize("direction", [(0, 0, 1), (-1, 0.3, -1.15), (1, 0, 0)])
def test_a_click_on_the_table_or_into_the_air_hits_nothing(direction):
    assert hit(POINTS, EYE, direction) is None


def test_an_empty_cloud_is_no_fault():
    nothing = np.zeros((0, 3))
    assert hit(nothing, EYE, (0, 0, -1)) is None
    assert not in_rectangle(nothing, camera(), (0, 0), (1, 1)).any()


def camera() -> ScreenCamera:
    """Looks straight down from 1 m above the middle between the blocks; the screen's right is -y."""
    return ScreenCamera((0.25, 0.0, TOP + 1.0), (0.0, np.sqrt(0.5), -np.sqrt(0.5), 0.0), np.deg2rad(60), 2.0)


def test_the_screen_camera_projects_as_a_pinhole():
    # x right = -y, y down = -x, z forward = down
    place, ahead = camera().project(np.array([(0.25, 0.0, TOP), (0.25, -0.2, TOP), (0.25, 0.0, TOP + 2.0)]))
    np.testing.assert_allclose(place[0], (0.5, 0.5), atol=1e-9)
    assert place[1, 0] == pytest.approx(0.5 + 0.2 / (2 * np.tan(np.deg2rad(30)) * 2.0))
    assert ahead.tolist() == [True, True, False]


def test_a_rectangle_takes_the_objects_in_it_without_the_table():
    mask = in_rectangle(POINTS, camera(), (0.5, 0.0), (1.0, 1.0))
    np.testing.assert_array_equal(POINTS[mask], NEAR[above_table(NEAR)])


def test_the_box_holds_the_points_and_reaches_the_table():
    box = box_around(NEAR)
    np.testing.assert_allclose(box.centre[:2], (0.25, -0.1), atol=1e-9)
    np.testing.assert_allclose(box.size[:2], 0.04 + 2 * MARGIN)
    assert box.low[2] == pytest.approx(TOP - MARGIN)
    assert box.high[2] == pytest.approx(TOP + 0.04 + MARGIN)

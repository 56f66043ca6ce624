"""Colours of clouds and scores."""

from __future__ import annotations

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.frames import apply
from dgs_viewer.colours import MOST_POINTS, by_height, from_picture, make_cloud, of_score, thinned
from dgs_viewer.pointing import above_table

CAMERA = PinholeCamera.centred(80, 60, 40.0)
T_BASE_CAMERA = CELL.T_base_camera_optical


def seen(*pixels: tuple[int, int]) -> np.ndarray:
    """Points in `base_link`, 1 m in front of the camera, that it sees at these pixels."""
    rays = [((u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, 1.0) for u, v in pixels]
    return apply(T_BASE_CAMERA, np.array(rays))


def test_a_point_has_the_colour_of_its_pixel():
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[10, 20], picture[50, 70] = (255, 0, 0), (0, 0, 255)
    colours = from_picture(seen((20, 10), (70, 50)), picture, CAMERA, T_BASE_CAMERA)
    assert colours.tolist() == [[255, 0, 0], [0, 0, 255]]


def test_a_point_outside_of_the_picture_is_coloured_by_height():
    behind = T_BASE_CAMERA[:3, 3] - T_BASE_CAMERA[:3, 2]
    points = np.concatenate([seen((500, 10)), behind[None]])
    picture = np.full((60, 80, 3), 9, np.uint8)
    np.testing.assert_array_equal(from_picture(points, picture, CAMERA, T_BASE_CAMERA), by_height(points))


def test_without_a_picture_higher_is_lighter():
    low, high = by_height(np.array([(0.3, 0, CELL.table_height), (0.3, 0, CELL.table_height + 0.1)]))
    assert high.sum() > low.sum()


def test_a_large_cloud_is_thinned_the_table_first():
    rng = np.random.default_rng(0)
    table = np.column_stack([rng.uniform(0, 0.5, (100_000, 2)), np.full(100_000, CELL.table_height)])
    objects = table[:5000] + (0, 0, 0.05)
    kept = thinned(np.concatenate([table, objects, [[np.nan, 0, 0]]]))
    assert len(kept) == MOST_POINTS
    assert above_table(kept).sum() == 5000
    many = thinned(np.concatenate([table, table + (0, 0, 0.05)]))
    assert len(many) == MOST_POINTS
    assert (~above_table(many)).sum() > 0.3 * MOST_POINTS


def test_a_cloud_of_nothing_is_no_fault():
    cloud = make_cloud(np.zeros((0, 3), np.float32), None, None, None)
    assert (cloud.points.shape, cloud.colours.shape) == ((0, 3), (0, 3))


def test_scores_go_from_red_to_green():
    worst, best = of_score(np.array([0.0, 1.0])).astype(int)
    assert worst[0] > worst[1] + 100
    assert best[1] > best[0] + 100

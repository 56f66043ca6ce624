"""Things that touch or cross: told apart by the middles that their cells vote for; what is one thing stays one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.contact.things import CELL, told_apart
from dgs_learning.training.views import ViewSettings, capture
from dgs_sim_bridge.render.object_model import from_parts
from tests.dgs_grasp_planner.scenes import apart, top


def block(x: float, y: float, size: tuple[float, float], height: float, turn: float = 0.0) -> np.ndarray:
    """The seen top of a box."""
    width, depth = ((-edge / 2, edge / 2) for edge in size)
    return top(width, depth, height) @ Rotation.from_euler("z", turn).as_matrix().T + (x, y, 0.0)


STEP = block(0.0, 0.0, (0.08, 0.08), 0.05), block(0.08, 0.0, (0.08, 0.08), 0.08)


Grid = tuple[np.ndarray, np.ndarray]


def voted(things: np.ndarray) -> Grid:
    """A grid of things, 0 = none: where something stands, and every cell's way to the middle of its thing."""
    way = np.zeros((2, *things.shape))
    for number in np.unique(things[things > 0]):
        cells = np.argwhere(things == number)
        way[:, things == number] = (cells.mean(axis=0) - cells).T * CELL
    return (things > 0).astype(np.int32), way.astype(np.float32)


def same(things: np.ndarray, truth: np.ndarray) -> bool:
    """Whether two numberings part the grid alike, the first by 1 to M."""
    pairs = np.unique(np.stack([things.ravel(), truth.ravel()]), axis=1)
    count = len(np.unique(truth))
    return pairs.shape[1] == count and np.array_equal(np.unique(things), np.arange(count))


def crossed() -> np.ndarray:
    """Two blocks that touch, and a stick over another, which is in two pieces."""
    things = np.zeros((70, 90), np.int32)
    things[5:25, 5:25], things[25:45, 5:30] = 1, 2
    things[20:24, 35:85], things[8:60, 50:54] = 3, 4
    return things


def test_what_touches_is_parted_and_what_is_crossed_is_one() -> None:
    things = crossed()
    assert same(told_apart(*voted(things)), things)


def test_votes_that_err_and_single_ones_that_say_something_else_change_little() -> None:
    things = crossed()
    owner, way = voted(things)
    rng = np.random.default_rng(0)
    noisy = (way + rng.normal(0.0, 0.006, way.shape)).astype(np.float32)
    found = told_apart(owner, noisy)
    assert len(np.unique(found)) == 5
    agree = [np.bincount(found[things == number]).max() / (things == number).sum() for number in (1, 2, 3, 4)]
    assert min(agree) > 0.97
    way[:, 10:12, 10:14] += 0.1
    assert same(told_apart(owner, way), things)


def test_a_middle_may_lie_beyond_the_grid_and_nothing_is_no_thing() -> None:
    owner = np.ones((20, 20), np.int32)
    for middle in ([30, 8], [-60, 90]):
        way = ((np.array(middle)[:, None, None] - np.indices((20, 20))) * CELL).astype(np.float32)
        assert (told_apart(owner, way) == 1).all()
    assert not told_apart(owner * 0, way).any()


def test_few_cells_are_one_thing_all_the_same() -> None:
    owner, way = voted((np.arange(36).reshape(6, 6) % 6 < 1).astype(np.int32))
    assert same(told_apart(owner, way), owner)


@pytest.mark.parametrize("turn", [0.0, 0.5])
@pytest.mark.parametrize("heights", [(0.05, 0.08), (0.06, 0.045)])
def test_boxes_that_touch_are_told_apart_in_what_a_camera_sees(
    turn: float, heights: tuple[float, float]
) -> None:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) / 2
    size = np.array([0.06, 0.07])
    models = [
        from_parts(f"box{k}", "cuboid", "box", [corners * (*size, h)], 0.1) for k, h in enumerate(heights)
    ]
    rotation = Rotation.from_euler("z", turn).as_matrix()
    poses = []
    for k, model in enumerate(models):
        T = np.eye(4)
        T[:3, :3] = rotation
        T[:3, 3] = rotation @ ((k - 0.5) * 0.061, 0.02 * k, 0.0) + (0.0, 0.0, -model.vertices[:, 2].min())
        poses.append(T)
    settings = replace(ViewSettings(), distance=(0.9, 0.9), elevation=(0.9, 0.9))
    view = capture(models, poses, np.random.default_rng(2), settings)
    high = view.points[:, 2] > 0.005
    field = height_field(view.points[high], view.camera, view.points[~high])
    separated = field.separated
    together = field.nearest(np.array([T[:3, 3] for T in poses]), 0.01)
    assert together[0] == together[1] > 0, "one shape"
    numbers = separated.nearest(np.array([T[:3, 3] for T in poses]), 0.01)
    assert len(set(numbers)) == 2 and numbers.all()
    for number, T in zip(numbers, poses, strict=True):
        np.testing.assert_allclose(separated.centres[number], T[:2, 3], atol=0.015)


def test_the_nearest_thing_within_reach() -> None:
    separated = apart(*STEP).separated
    low, high, none = separated.nearest(np.array([[-0.06, 0.0], [0.14, 0.0], [-0.12, 0.0]]), 0.05)
    assert low and high and low != high and none == 0

"""Things that touch: told apart where a border lies between their insides, and what is one thing stays one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.contact.things import INSIDE, split
from dgs_learning.training.views import ViewSettings, capture
from dgs_sim_bridge.render.object_model import from_parts
from tests.dgs_grasp_planner.scenes import apart


def block(x: float, y: float, size: tuple[float, float], height: float, turn: float = 0.0) -> np.ndarray:
    """The seen top of a box."""
    u, v = np.meshgrid(*(np.arange(-edge / 2, edge / 2, 0.0015) for edge in size))
    top = np.column_stack([u.ravel(), v.ravel(), np.full(u.size, height)])
    return top @ Rotation.from_euler("z", turn).as_matrix().T + (x, y, 0.0)


STEP = block(0.0, 0.0, (0.08, 0.08), 0.05), block(0.08, 0.0, (0.08, 0.08), 0.08)


def shapes() -> tuple[np.ndarray, np.ndarray]:
    """Two shapes, and no border."""
    owner = np.zeros((40, 60), np.int32)
    owner[5:25, 5:25], owner[30:38, 5:55] = 1, 2
    return owner, np.zeros(owner.shape, np.float32)


def test_a_border_through_a_shape_parts_it_and_the_others_keep_their_numbers() -> None:
    owner, border = shapes()
    border[30:38, 28:32] = 0.9
    things = split(owner, border)
    assert ((things > 0) == (owner > 0)).all() and (things[owner == 1] == 1).all()
    left, right = things[30:38, 5:30], things[30:38, 30:55]
    assert {left[0, 0], right[0, -1]} == {2, 3}
    assert (left == left[0, 0]).all() and (right == right[0, -1]).all(), (
        "the border goes to the nearer inside"
    )


def test_a_border_that_goes_not_through_and_a_small_corner_part_nothing() -> None:
    owner, border = shapes()
    border[30:36, 28:32] = 0.9
    border[5:10, 5 + INSIDE // 6 : 9 + INSIDE // 6] = 0.9
    border[10:14, 5:9] = 0.9
    np.testing.assert_array_equal(split(owner, border), owner)


def test_numbers_of_new_things_are_new() -> None:
    owner, border = shapes()
    border[14:16, 5:25] = border[30:38, 20:22] = border[30:38, 40:42] = 0.9
    assert np.unique(split(owner, border)).tolist() == [0, 1, 2, 3, 4, 5]


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
    assert field is not None
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

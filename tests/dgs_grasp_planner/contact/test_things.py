"""Things that touch: told apart at a step in height and at a neck, and what is one thing stays one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_grasp_planner.contact.height_field import HeightField
from tests.dgs_grasp_planner.scenes import field_of


def block(x: float, y: float, size: tuple[float, float], height: float, turn: float = 0.0) -> np.ndarray:
    """The seen top of a box."""
    u, v = np.meshgrid(*(np.arange(-edge / 2, edge / 2, 0.0015) for edge in size))
    top = np.column_stack([u.ravel(), v.ravel(), np.full(u.size, height)])
    return top @ Rotation.from_euler("z", turn).as_matrix().T + (x, y, 0.0)


def things(field: HeightField) -> list[int]:
    owner = field.separated.owner
    assert ((owner > 0) == (field.owner > 0)).all()
    return np.unique(owner[owner > 0]).tolist()


STEP = block(0.0, 0.0, (0.08, 0.08), 0.05), block(0.08, 0.0, (0.08, 0.08), 0.08)
NECK = block(0.0, 0.0, (0.08, 0.08), 0.05), block(0.102, 0.0, (0.08, 0.08), 0.05, np.pi / 4)


@pytest.mark.parametrize("blocks", [STEP, NECK])
def test_a_step_in_height_and_a_neck_part_a_shape(blocks: tuple[np.ndarray, ...]) -> None:
    field = field_of(*blocks)
    assert len(np.unique(field.owner)) == 2 and len(things(field)) == 2
    separated = field.separated
    for each in blocks:
        middle = each[:, :2].mean(axis=0)
        (number,) = separated.nearest(middle[None], 0.01)
        np.testing.assert_allclose(separated.centres[number], middle, atol=0.012)


@pytest.mark.parametrize("size", [(0.2, 0.15), (0.2, 0.03), (0.01, 0.15)])
def test_one_thing_stays_one_with_its_number(size: tuple[float, float]) -> None:
    field = field_of(block(0.0, 0.0, size, 0.04), block(0.3, 0.0, (0.05, 0.05), 0.04))
    assert things(field) == np.unique(field.owner)[1:].tolist()


def test_numbers_of_new_things_are_new() -> None:
    far = block(0.4, 0.0, (0.05, 0.05), 0.04)
    field = field_of(*STEP, far, *(each + (0.0, 0.4, 0.0) for each in STEP))
    numbers = things(field)
    assert len(numbers) == 5 and set(np.unique(field.owner)[1:]) < set(numbers)


def test_the_nearest_thing_within_reach() -> None:
    separated = field_of(*STEP).separated
    low, high, none = separated.nearest(np.array([[-0.06, 0.0], [0.14, 0.0], [-0.12, 0.0]]), 0.05)
    assert low and high and low != high and none == 0

"""Shapes of a height field: width, middle, how much of their hull they fill; the side of them that is met first."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_grasp_planner.contact.shape import near_side
from dgs_grasp_planner.contact.things import CELL
from tests.dgs_grasp_planner.contact.test_height_field import BOX
from tests.dgs_grasp_planner.scenes import field_of


def test_widths_of_what_the_hand_does_not_fit_around() -> None:
    turn = np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    box_and_case = np.concatenate([BOX @ turn, BOX * (2.0, 1.6, 0.3) @ turn + (0.3, 0.0, 0.0)])
    shapes = field_of(box_and_case).shapes
    assert [shape.width for shape in shapes.values()] == pytest.approx([0.06, 0.12], abs=0.012)
    assert [shape.thickness for shape in shapes.values()] == pytest.approx([0.06, 0.018])
    assert all(number == shape.number and len(shape.cells) > 8 for number, shape in shapes.items())


def test_the_centre_of_mass_is_where_the_shape_is_high() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(0.0, 0.1, 0.0015), np.arange(0.0, 0.06, 0.0015)))
    (wedge,) = field_of(np.column_stack([x, y, 0.02 + 0.6 * x])).shapes.values()
    # A trapezoid's: (h1 + 2 h2) / (h1 + h2) / 3 of its length.
    expected = [0.1 * (0.02 + 2 * 0.08) / (0.02 + 0.08) / 3, 0.03]
    np.testing.assert_allclose(wedge.centre_of_mass, expected, atol=0.002)


def test_a_box_fills_its_hull_and_an_angle_does_not() -> None:
    (box,) = field_of(BOX).shapes.values()
    (angle,) = field_of(BOX[(BOX[:, 0] < 0.0) | (BOX[:, 1] < 0.0)]).shapes.values()
    assert box.solidity == pytest.approx(1.0)
    assert angle.solidity == pytest.approx(6 / 7, abs=0.03)


def test_a_bowl_is_a_vessel_and_what_is_too_low_to_tell_is_none() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.arange(-0.06, 0.06, 0.0015)] * 2))
    radius = np.hypot(x, y)
    bowl = np.column_stack([x, y, np.where(radius > 0.05, 0.05, 0.02)])[radius < 0.06]
    for height, vessel in ((1.0, True), (0.45, False)):
        (shape,) = field_of(bowl * (1.0, 1.0, height)).shapes.values()
        assert shape.vessel == vessel


def test_the_near_side_does_not_follow_single_cells() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(0.1, 0.2, CELL), np.arange(-0.05, 0.05, CELL)))
    points = np.concatenate([np.column_stack([x, y]), [[0.05, 0.0]]])
    ahead, at = np.array([1.0, 0.0]), np.array([-0.1, 0.0])
    assert near_side(points, ahead, at, 0.03) == pytest.approx(0.2, abs=CELL)
    assert near_side(points, ahead, at, 0.03, share=0.0) == pytest.approx(0.15, abs=CELL)
    assert near_side(points, -ahead, at, 0.03) == pytest.approx(-0.3, abs=CELL)
    assert near_side(points, ahead, at + [0.0, 0.2], 0.03) is None
    split = points[np.abs(points[:, 1]) > 0.01]
    assert near_side(split, ahead, at, 0.03, share=1.0) == pytest.approx(0.2, abs=CELL)

"""The height field against brute force, and what it leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import CELL, height_field
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, top
from tests.support.refused import refused

BOX = top((-0.03, 0.0301), (-0.05, 0.0501), 0.06)
"""The seen top of a box 60 mm wide, 100 mm long, 60 mm high."""


def spheres_at(points: np.ndarray) -> np.ndarray:
    """(N, 10, 3) a finger with all its spheres at each of the points (N, 3)."""
    return np.repeat(points[:, None], len(HAND.sphere_radii), axis=1)


def test_clearance_is_that_of_balls_over_columns() -> None:
    field = field_of(BOX)
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.06, -0.08, 0.01), (0.06, 0.08, 0.10), (400, 3))
    found = field.clearance(spheres_at(points))
    outside = np.maximum(np.abs(points[:, :2]) - (0.03, 0.05), 0.0)
    across = np.linalg.norm(outside, axis=1)
    for k, radius in enumerate(HAND.sphere_radii):
        touching = (across < radius) & (points[:, 2] < 0.06 + np.sqrt(np.maximum(radius**2 - across**2, 0.0)))
        sure = np.abs(across - radius) > 2 * CELL
        vertical = np.abs(points[:, 2] - 0.06 - np.sqrt(np.maximum(radius**2 - across**2, 0))) > 2 * CELL
        clear = sure & vertical
        np.testing.assert_array_equal(found[clear, k] < 0, touching[clear])
    assert HAND.sphere_phalanx.max() == 2


def test_walls_have_horizontal_normals_and_tops_upright_ones() -> None:
    field = field_of(BOX)
    radius = HAND.sphere_radii[-1]
    side = field.normals(np.array([[0.03 + radius, 0.0, 0.03], [0.0, -0.05 - radius, 0.03]]))
    np.testing.assert_allclose(side, [[1, 0, 0], [0, -1, 0]], atol=0.25)
    np.testing.assert_allclose(field.normals(np.array([[0.0, 0.0, 0.07]])), [[0, 0, 1]], atol=0.05)


def test_shapes_are_told_apart_and_noise_is_dropped() -> None:
    other = BOX * (0.5, 0.5, 0.5) + (0.0, 0.2, 0.0)
    field = field_of(BOX, other, [[0.15, 0.0, 0.03]])
    places = np.array([[0.0, 0.0], [0.0, 0.2], [0.15, 0.0], [0.0, 0.12]])
    owner = field.owner.ravel()[field.cells(places)]
    assert owner[0] > 0 and owner[1] > 0 and owner[0] != owner[1]
    assert owner[2] == 0 and owner[3] == 0
    np.testing.assert_allclose(field.centres[owner[:2]], places[:2], atol=CELL)
    np.testing.assert_allclose(field.top(places)[:2], [0.06, 0.03], atol=1e-6)
    assert (field.top(places)[2:] < 0).all()


@pytest.mark.parametrize("cloud", [np.zeros((0, 3)), np.full((50, 3), 0.004)])
def test_a_bare_table_has_none(cloud: np.ndarray) -> None:
    with refused(ErrorCode.NO_OBJECTS):
        height_field(cloud)


def test_far_away_nothing_stands() -> None:
    field = field_of(BOX)
    far = np.array([[9.0, 9.0, 0.001], [-9.0, 0.0, 0.001]])
    assert (field.clearance(spheres_at(far)) > 0.5).all()


def test_a_plate_has_a_floor_and_a_ring_has_none() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.arange(-0.1, 0.1, 0.0015)] * 2))
    radius = np.hypot(x, y)
    rim = (radius > 0.075) & (radius < 0.1)
    lump = radius < 0.006
    seen = np.column_stack([x, y, np.full(x.size, 0.015)])[rim]
    noise = np.column_stack([x, y, np.where(radius < 0.003, 0.014, 0.010)])[lump]
    low = np.column_stack([x, y, np.full(x.size, 0.005)])[radius < 0.07]
    for floor, filled in ((0.005, True), (0.001, False)):
        field = field_of(seen, noise, low=low * (1.0, 1.0, floor / 0.005))
        middle = field.cells(np.array([[0.0, 0.0], [0.04, 0.0]]))
        ring = field.owner.ravel()[field.cells(np.array([[0.09, 0.0]]))]
        assert (field.owner.ravel()[middle] == ring).all() == filled
        assert (field.top(np.array([[0.04, 0.0]])) > 0) == filled
    completed = field_of(seen, noise, low=low, camera=CAMERA)
    assert completed.top(np.array([0.04, 0.0])) > 0 and (completed.feared >= completed.floors).all()


def test_what_stands_on_a_plate_is_a_thing_of_its_own() -> None:
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.arange(-0.1, 0.1, 0.0015)] * 2))
    radius = np.hypot(x, y)
    height = np.select([radius < 0.015, radius < 0.07, radius > 0.075], [0.03, 0.005, 0.015])
    cloud = np.column_stack([x, y, height])[(radius < 0.1) & (height > 0)]
    low = cloud[:, 2] == 0.005
    field = field_of(cloud[~low], low=cloud[low])
    egg, floor, rim = field.owner.ravel()[field.cells(np.array([[0.0, 0.0], [0.05, 0.0], [0.09, 0.0]]))]
    assert egg > 0 and floor == rim > 0 and egg != rim


def test_a_fork_is_between_contacts_on_its_two_prongs_and_two_things_are_not() -> None:
    prongs, handle = [BOX * (0.2, 1, 0.3) + (x, 0.0, 0.0) for x in (-0.02, 0.02)], BOX * (0.9, 0.2, 0.3)
    sides = np.array([[-0.026, -0.03, 0.01]]), np.array([[0.026, -0.03, 0.01]])
    fork = field_of(*prongs, handle + (0.0, 0.05, 0.0))
    pair = field_of(*prongs)
    for contacts in (sides, sides[::-1]):
        owner, point = fork.between(*contacts)
        assert owner == 1 and abs(abs(point[0, 0]) - 0.02) < 0.006, "on one of the prongs"
        assert abs(fork.top(point) - 0.018) < 1e-6
    assert pair.between(*sides)[0] == 0, "one thing to the left, another to the right"
    owner, point = pair.between(sides[0], sides[0] + (0.012, 0.0, 0.0))
    assert owner > 0
    np.testing.assert_allclose(point, [[-0.02, -0.03, 0.01]])

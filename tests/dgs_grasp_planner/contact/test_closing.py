"""Kinematic closing: fingers end where they touch, idle ones stay, and what meets nothing keeps its prediction."""

from __future__ import annotations

import numpy as np

from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import PREDICTED, ClosingPath, Touch, closed, closing_path, touch
from dgs_grasp_planner.contact.height_field import HeightField
from tests.dgs_grasp_planner.scenes import field_of

DOWN = np.diag([1.0, -1.0, -1.0])
FINAL = np.tile([0.0, 0.45, 0.45, 0.45], 5)


def grasp(x: float = 0.0, z: float = 0.06, final: np.ndarray = FINAL) -> GraspSet:
    """One hand from above."""
    place = np.array([[x, 0.0, z]])
    return GraspSet.of(
        "test",
        position=place,
        rotation=DOWN,
        pre_grasp_joints=HAND.pre_grasp(final),
        grasp_joints=final,
        active_fingers=HAND.split(final)[:, 1] > 0,
        score=[1.0],
        reference_point=place,
    )


def bar(half_width: float, height: float = 0.07) -> np.ndarray:
    """The seen top of a bar along y, across the hand's x."""
    x, y = np.meshgrid(np.arange(-half_width, half_width + 1e-9, 0.001), np.arange(-0.07, 0.0701, 0.0015))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])


def touched(one: GraspSet, field: HeightField) -> tuple[ClosingPath, Touch]:
    """One hand's way of closing, and where its fingers end."""
    path = closing_path(one)
    return path, closed(path, one.position, one.rotation, field)


def test_fingers_stop_at_the_bar_and_a_wider_bar_stops_them_earlier() -> None:
    progress = []
    for half_width in (0.012, 0.022):
        field = field_of(bar(half_width))
        one = grasp()
        path, contact = touched(one, field)
        met = contact.met[0]
        assert met[0] and met[1:].sum() >= 2
        shapes = path.joints(contact.progress[:, None] + [[0.0], [0.05]])[0]
        spheres = HAND.finger_spheres(shapes) @ one.rotation[0].T + one.position[0]
        free, pushed = field.clearance(spheres).min(axis=-1)[:, met]
        assert (free >= 0).all(), "the contact posture is free"
        assert (pushed < 0).all(), "a little more would cut the bar"
        np.testing.assert_allclose(contact.normal[0, 0], [1, 0, 0], atol=0.3)
        progress.append(contact.progress[0][met].mean())
    assert progress[1] < progress[0] - 0.1


def test_fingers_held_off_are_as_far_away_as_asked() -> None:
    path, contact = touched(grasp(), field_of(bar(0.012)))
    np.testing.assert_array_equal(contact.held_off(0.0), contact.progress)
    shapes = [HAND.finger_spheres(path.joints(p))[0] for p in (contact.progress, contact.held_off(0.002))]
    moved = np.linalg.norm(shapes[1] - shapes[0], axis=-1).max(axis=-1)[contact.met[0]]
    assert ((moved > 0.0015) & (moved < 0.006)).all()


def test_what_meets_nothing_keeps_the_prediction() -> None:
    path, contact = touched(grasp(), field_of(bar(0.012) + (0.4, 0.0, 0.0)))
    assert not contact.met.any()
    assert (contact.progress == PREDICTED).all()
    np.testing.assert_allclose(path.joints(contact.progress)[0].ravel(), FINAL)


def test_idle_fingers_stay() -> None:
    final = HAND.split(FINAL).copy()
    final[3:] = 0.0
    path, contact = touched(grasp(final=final.ravel()), field_of(bar(0.02)))
    assert path.active[0].tolist() == [True, True, True, False, False]
    assert not contact.met[0, 3:].any()
    assert (path.nodes[0, :, 3:] == 0).all() and (path.joints(contact.progress)[0, 3:] == 0).all()


def test_the_open_hand_is_straight_for_a_pre_grasp_by_equation_9() -> None:
    nodes = closing_path(grasp()).nodes[0]
    np.testing.assert_allclose(nodes[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(nodes[1].ravel(), HAND.pre_grasp(FINAL))


def test_places_of_one_hand_come_one_after_another() -> None:
    field = field_of(bar(0.015))
    one = grasp()
    places = np.array([[[0.0, 0.0, 0.06], [0.3, 0.0, 0.06], [0.0, 0.0, 0.06]]])
    contact = touch(closing_path(one), places, one.rotation, field)
    np.testing.assert_array_equal(contact.met[0], contact.met[2])
    assert contact.met[0, 0] and not contact.met[1].any()

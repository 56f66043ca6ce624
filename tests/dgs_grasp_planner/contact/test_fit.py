"""Refinement: towards the object, onto its surface, better contacts first; and every step can be switched off."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet
from dgs_description.hand_model import SPHERE_RADII, finger_spheres
from dgs_grasp_planner.contact.fit import PUSHES, UNHELD, RefineConfig, refine, way_is_free
from dgs_grasp_planner.contact.height_field import height_field
from tests.dgs_grasp_planner.contact.test_closing import bar, grasp
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene

HALF_WIDTH, HEIGHT = 0.015, 0.07
BAR = bar(HALF_WIDTH, HEIGHT)


def penetration(grasps: GraspSet) -> float:
    """How deep the first hand's fingers are in the bar, a box that stands on the table [m]."""
    world = finger_spheres(grasps.grasp_joints[0]) @ grasps.rotation[0].T + grasps.position[0]
    low, high = np.array([-HALF_WIDTH, -0.07, 0.0]), np.array([HALF_WIDTH, 0.07, HEIGHT])
    outside = np.linalg.norm(np.maximum(np.maximum(low - world, world - high), 0.0), axis=-1)
    inside = np.minimum(world - low, high - world).min(axis=-1)
    return float((SPHERE_RADII - np.where(inside > 0, -inside, outside)).max())


@pytest.mark.parametrize("aside", [-0.010, 0.020])
def test_a_hand_beside_the_bar_is_moved_over_it(aside: float) -> None:
    refined = refine(grasp(x=aside), BAR, CAMERA)
    assert abs(refined.position[0, 0]) < abs(aside) - 0.006
    np.testing.assert_allclose(refined.position, refined.reference_point + refined.offset)
    stays = refine(grasp(x=aside), BAR, CAMERA, RefineConfig(move=False))
    assert stays.position[0, 0] == pytest.approx(aside)


def test_the_final_hand_touches_and_does_not_cut() -> None:
    closed = grasp()
    assert penetration(closed) > 0.010
    assert penetration(refine(closed, BAR, CAMERA)) < 0.003
    kept = refine(closed, BAR, CAMERA, RefineConfig(close=False))
    np.testing.assert_array_equal(kept.grasp_joints, closed.grasp_joints)


def test_what_holds_nothing_comes_last_and_keeps_its_shape() -> None:
    nowhere, there = grasp(x=0.3), grasp()
    refined = refine(nowhere.joined(there), BAR, CAMERA)
    assert refined.position[0, 0] < 0.1 < refined.position[1, 0]
    assert refined.score[1] == pytest.approx(UNHELD) and refined.score[0] > 0.5
    np.testing.assert_array_equal(refined.grasp_joints[1], nowhere.grasp_joints[0])
    unranked = refine(nowhere.joined(there), BAR, CAMERA, RefineConfig(rank=False))
    np.testing.assert_array_equal(unranked.score, [1.0, 1.0])
    assert unranked.position[0, 0] == pytest.approx(0.3)


def test_across_the_bar_is_better_than_along_it() -> None:
    across = grasp()
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    along = replace(across, rotation=turn @ across.rotation)
    refined = refine(along.joined(across), BAR, CAMERA)
    np.testing.assert_allclose(refined.rotation[0], across.rotation[0])
    assert refined.score[0] > refined.score[1] + 0.1


def test_all_off_changes_nothing_and_nothing_to_refine_is_fine() -> None:
    one = grasp(x=0.007)
    off = refine(one, BAR, CAMERA, RefineConfig(move=False, close=False, rank=False))
    np.testing.assert_array_equal(off.position, one.position)
    assert len(refine(GraspSet.empty(), BAR, CAMERA)) == 0
    np.testing.assert_array_equal(refine(one, np.zeros((0, 3)), CAMERA).position, one.position)


def test_the_table_is_not_cut() -> None:
    def lowest(grasps: GraspSet) -> float:
        spheres = finger_spheres(np.stack([grasps.pre_grasp_joints[0], grasps.grasp_joints[0]]))
        return float(((spheres @ grasps.rotation[0].T + grasps.position[0])[..., 2] - SPHERE_RADII).min())

    low = grasp(z=0.045)
    refined = refine(low, BAR, CAMERA)
    assert lowest(low) < -0.008
    assert lowest(refined) > -0.004 and refined.score[0] > 0.5


def test_it_is_fast_enough_for_a_scene() -> None:
    cloud = table_scene(0)
    one = grasp()
    many = one.select(np.zeros(32, dtype=int))
    rng = np.random.default_rng(0)
    many = replace(many, position=many.position + rng.uniform(-0.1, 0.1, (32, 3)) * (1, 1, 0))
    refine(many, cloud, CAMERA)
    spent = []
    for _ in range(3):
        start = time.process_time()
        refine(many, cloud, CAMERA)
        spent.append(time.process_time() - start)
    assert min(spent) < 0.2, "about 40 ms on an idle core"


def test_a_hand_that_would_push_something_on_its_way_comes_later() -> None:
    wall = np.random.default_rng(0).uniform((0.10, -0.07, 0.02), (0.14, 0.07, 0.13), (20_000, 3))
    turned = Rotation.from_euler("y", 35, degrees=True).as_matrix()
    straight = grasp(z=0.075, final=np.tile([0.0, 0.2, 0.2, 0.2], 5)).select([0, 0])
    hands = replace(straight, rotation=np.stack([turned @ straight.rotation[0], straight.rotation[0]]))
    field = height_field(np.vstack([BAR, wall]))
    assert field is not None
    alone = height_field(BAR)
    assert alone is not None
    beside, above = way_is_free(hands, field)
    assert above == 1.0 and beside == PUSHES
    np.testing.assert_array_equal(way_is_free(hands, alone), [1.0, 1.0])
    refined = refine(hands, np.vstack([BAR, wall]), CAMERA, RefineConfig(move=False, close=False))
    np.testing.assert_allclose(refined.rotation[0], hands.rotation[1])

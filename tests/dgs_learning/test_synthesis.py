"""Stage 1 and 2: distances, constraints, reproducible validated grasps, collision-free scene grasps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.frames import apply
from dgs_description.hand_model import SPHERE_RADII, finger_spheres, fingertips, inverse_kinematics
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.objects import shapes
from dgs_learning.synthesis.candidates import fingertip_targets, sample_guided, sample_uniform
from dgs_learning.synthesis.closing import approach_is_free
from dgs_learning.synthesis.scenes import make_scene
from dgs_learning.synthesis.sdf import signed_distance
from dgs_learning.synthesis.stage_one import MAX_PENETRATION, resting_ups, synthesise_chunk
from dgs_learning.synthesis.stage_two import valid_in_scene
from dgs_learning.synthesis.trial import FloatingHand
from dgs_sim_bridge.render.object_model import from_parts


@pytest.fixture(scope="module")
def block():
    return from_parts("block", "cuboid", "block", shapes.box([0.05, 0.06, 0.08]), 0.2)


@pytest.fixture(scope="module")
def block_grasps(block):
    sdf = signed_distance(block)
    ups = resting_ups(block, 0)
    return sdf, ups, synthesise_chunk(block, sdf, ups, [3, 0], draws=200, max_trials=8)


def test_signed_distance_of_a_box_equals_the_formula(block):
    sdf = signed_distance(block)
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3)) * np.array([0.042, 0.047, 0.057])
    outside = np.abs(points) - np.array([0.025, 0.03, 0.04])
    exact = np.linalg.norm(np.maximum(outside, 0), axis=1) + np.minimum(outside.max(1), 0)
    assert np.abs(sdf(points) - exact).max() < 0.0012
    assert np.abs(sdf(points) - exact).mean() < 1e-4


def test_signed_distance_sees_a_thin_wall():
    cup = from_parts("cup", "bowl", "cup", shapes.vessel([(0.04, 0), (0.04, 0.08)], 0.004, sectors=24), 0.2)
    sdf = signed_distance(cup)
    wall = np.array([[0.0378, 0.0, 0.01]])
    assert sdf(wall)[0] < 0
    assert sdf(np.array([[0.02, 0.0, 0.01]]))[0] > 0.01


def test_fingertip_targets_follow_equations_seven_and_eight():
    tips = fingertip_targets(np.array([True, False]), np.array([0.03, 0.03]), np.array([-0.01, -0.01]))
    assert np.allclose(tips[0, 0, :2], 0.03 * np.array([np.cos(np.deg2rad(15)), np.sin(np.deg2rad(15))]))
    assert np.allclose(tips[0, 1:, 0], 0.03 * np.cos(np.deg2rad([120, 150, 180, 210])))
    assert np.allclose(tips[1, :, 0], [0.024, -0.03, -0.03, -0.03, -0.03])
    assert np.allclose(tips[1, 1:, 1], [0.0375, 0.0125, -0.0125, -0.0375]), (
        "mirrored against the printed (8b)"
    )
    reached = fingertips(inverse_kinematics(tips))
    assert np.linalg.norm(reached - tips, axis=-1).mean() < 0.02


def test_uniform_draw_covers_box_and_rotations(block):
    drawn = sample_uniform(np.random.default_rng(0), block, 500, 5)
    low, high = block.bounds
    assert (drawn.grasps.position > low - 1e-9).all() and (drawn.grasps.position < high + 1e-9).all()
    assert np.linalg.norm(drawn.grasps.rotation[:, :, 2].mean(0)) < 0.15


def test_guided_draw_keeps_the_palm_out_of_object_and_table(block, block_grasps):
    sdf, ups, _ = block_grasps
    drawn = sample_guided(np.random.default_rng(0), block, sdf, 200, 5, ups)
    assert len(drawn) > 50
    free = approach_is_free(drawn, sdf)
    assert 0 < free.sum() < len(drawn)


def test_no_candidates_are_fine_everywhere(block, block_grasps):
    sdf, ups, _ = block_grasps
    none = sample_uniform(np.random.default_rng(0), block, 0, 5)
    assert not len(approach_is_free(none, sdf))
    assert not len(synthesise_chunk(block, sdf, ups, [3, 9], draws=4, max_trials=2, uniform_share=1.0).grasps)


def test_no_more_are_drawn_than_are_simulated(block, block_grasps):
    sdf, ups, _ = block_grasps
    few, many = (synthesise_chunk(block, sdf, ups, [3, 1], draws=400, max_trials=n) for n in (1, 8))
    assert few.trials == 1 and many.trials == 8
    assert few.drawn < many.drawn <= 400


def test_chunk_gives_the_same_grasps_again(block, block_grasps):
    sdf, ups, first = block_grasps
    again = synthesise_chunk(block, sdf, ups, [3, 0], draws=200, max_trials=8)
    assert len(first.grasps) >= 2 and (first.drawn, first.trials) == (again.drawn, again.trials)
    for name, values in vars(first.grasps).items():
        assert np.array_equal(values, getattr(again.grasps, name)), name


def test_stored_grasps_are_sound_and_pass_again(block, block_grasps):
    sdf, _, found = block_grasps
    grasps = found.grasps
    joints = grasps.grasp_joints.reshape(-1, 5, 4)
    assert np.array_equal(joints[..., 2], joints[..., 3])
    spheres = posed(finger_spheres(joints), grasps.position, grasps.rotation)
    assert sdf.clearance(spheres).min() > -MAX_PENETRATION
    with FloatingHand(block) as world:
        held = [world.close(grasps[i]).touching and world.shake() for i in range(len(grasps))]
    assert np.mean(held) >= 0.75


def test_scene_settles_on_the_table_and_repeats(block):
    tall = from_parts("can", "cylinder", "can", shapes.lathe([(0.03, 0), (0.03, 0.1)]), 0.2)
    a, b = (make_scene([block, tall], [0, 1, 0], [7, 1], (0.4, 0.4)) for _ in range(2))
    assert np.array_equal(a.T_table_object, b.T_table_object)
    assert len(a.objects) >= 2
    for k, T in zip(a.objects, a.T_table_object, strict=True):
        lowest = ([block, tall][k].vertices @ T[:3, :3].T + T[:3, 3])[:, 2].min()
        assert -0.002 < lowest < 0.003


def test_scene_keeps_no_grasp_through_the_table(block, block_grasps):
    sdf, _, found = block_grasps
    grasps = found.grasps
    scene = make_scene([block], [0], [1, 1], (0.4, 0.4))
    (kept,) = valid_in_scene(scene, [grasps], [sdf])
    T = scene.T_table_object[0]
    for i in kept:
        world = apply(T @ grasps[i].pose, finger_spheres(grasps[i].grasp_joints).reshape(-1, 3))
        assert (world[:, 2] - np.tile(SPHERE_RADII, 5)).min() > 0
    upside_down = replace(grasps, rotation=np.tile(T[:3, :3].T, (len(grasps), 1, 1)))
    (none,) = valid_in_scene(scene, [upside_down], [sdf])
    assert not len(none), "a hand that comes from below the table was kept"

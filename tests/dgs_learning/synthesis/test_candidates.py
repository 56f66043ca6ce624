"""Fingertip constraints, and both ways of drawing hands."""

from __future__ import annotations

import numpy as np

from dgs_description.hand import HAND
from dgs_description.hand_ik import inverse_kinematics
from dgs_learning.synthesis.candidates import fingertip_targets, sample_guided, sample_uniform
from dgs_learning.synthesis.closing import approach_is_free


def test_fingertip_targets_follow_equations_seven_and_eight():
    tips = fingertip_targets(np.array([True, False]), np.array([0.03, 0.03]), np.array([-0.01, -0.01]))
    assert np.allclose(tips[0, 0, :2], 0.03 * np.array([np.cos(np.deg2rad(15)), np.sin(np.deg2rad(15))]))
    assert np.allclose(tips[0, 1:, 0], 0.03 * np.cos(np.deg2rad([120, 150, 180, 210])))
    assert np.allclose(tips[1, :, 0], [0.024, -0.03, -0.03, -0.03, -0.03])
    assert np.allclose(tips[1, 1:, 1], [0.0375, 0.0125, -0.0125, -0.0375]), (
        "mirrored against the printed (8b)"
    )
    reached = HAND.fingertips(inverse_kinematics(HAND, tips))
    assert np.linalg.norm(reached - tips, axis=-1).mean() < 0.02


def test_uniform_draw_covers_box_and_rotations(block):
    drawn = sample_uniform(np.random.default_rng(0), block, 500, 5)
    low, high = block.bounds
    assert (drawn.grasps.position > low - 1e-9).all() and (drawn.grasps.position < high + 1e-9).all()
    assert np.linalg.norm(drawn.grasps.rotation[:, :, 2].mean(0)) < 0.15


def test_guided_draw_keeps_the_palm_out_of_object_and_table(block, sdf, ups):
    drawn = sample_guided(np.random.default_rng(0), block, sdf, 200, 5, ups)
    assert len(drawn) > 50
    free = approach_is_free(drawn, sdf)
    assert 0 < free.sum() < len(drawn)

"""Signed distances on a grid against the formula, and of thin walls."""

from __future__ import annotations

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.synthesis.sdf import signed_distance
from dgs_sim_bridge.render.object_model import from_parts


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

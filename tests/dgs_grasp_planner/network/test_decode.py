"""Non-maximum suppression, hypotheses, rotations, joints."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from dgs_description.grasp import non_maximum_suppression
from dgs_description.hand import HAND
from dgs_grasp_planner.network.decode import (
    grasps_from_outputs,
    limited_joints,
    matrix_from_6d,
    rank_hypotheses,
)
from dgs_grasp_planner.network.rotation import matrix_from_6d as matrix_from_6d_torch


def test_suppression_against_the_definition() -> None:
    rng = np.random.default_rng(0)
    points, score = rng.uniform(0, 0.2, (400, 3)), rng.random(400)
    kept = non_maximum_suppression(points, score, 0.025, 1000)
    wanted: list[int] = []
    for k in np.argsort(-score):
        if all(np.linalg.norm(points[k] - points[j]) > 0.025 for j in wanted):
            wanted.append(int(k))
    assert kept.tolist() == wanted
    assert non_maximum_suppression(points, score, 0.025, 7).tolist() == wanted[:7]
    assert len(non_maximum_suppression(points[:0], score[:0], 0.025, 7)) == 0


def test_hypotheses_are_ranked_relative_to_the_likeliest() -> None:
    order, weight = rank_hypotheses(np.log([[0.1, 0.6, 0.3]]), 2)
    assert order.tolist() == [[1, 2]]
    np.testing.assert_allclose(weight, [[1.0, 0.5]])


def test_6d_of_a_rotation_gives_it_back_as_the_networks_does() -> None:
    wanted = Rotation.random(20, random_state=0).as_matrix()
    scaled = np.concatenate([3 * wanted[..., 0], 0.2 * wanted[..., 1] + 0.5 * wanted[..., 0]], axis=-1)
    np.testing.assert_allclose(matrix_from_6d(scaled), wanted, atol=1e-12)
    np.testing.assert_allclose(matrix_from_6d_torch(torch.from_numpy(scaled)).numpy(), wanted, atol=1e-9)


def test_joints_are_limited_and_coupled() -> None:
    joints = limited_joints(np.random.default_rng(0).normal(0, 3, (30, 15)))
    assert joints.shape == (30, 20)
    assert (joints >= HAND.lower - 1e-12).all() and (joints <= HAND.upper + 1e-12).all()
    np.testing.assert_array_equal(joints[:, 3::4], joints[:, 2::4])


def test_tcp_is_reference_point_plus_offset_and_grasps_are_sorted() -> None:
    rng = np.random.default_rng(0)
    point, offset, score = rng.normal(size=(6, 3)), rng.normal(size=(6, 3)), rng.random(6)
    grasps = grasps_from_outputs(
        point, score, rng.normal(size=(6, 6)), offset, np.zeros((6, 15)), np.zeros((6, 15))
    )
    order = np.argsort(-score)
    np.testing.assert_allclose(grasps.position, (point + offset)[order])
    np.testing.assert_allclose(grasps.score, score[order])
    np.testing.assert_allclose(grasps.position, grasps.reference_point + grasps.offset)


def test_fingers_that_do_not_bend_take_no_part() -> None:
    j_init, j_end = np.zeros((2, 1, 5, 3))
    j_end[0, :3, 1], j_end[0, 3, 1], j_end[0, 4, 0] = 0.5, 0.04, 0.3
    shapes = (j_init.reshape(1, 15), j_end.reshape(1, 15))
    grasps = grasps_from_outputs(
        np.zeros((1, 3)), np.ones(1), np.eye(3)[None, :2].reshape(1, 6), np.zeros((1, 3)), *shapes
    )
    assert grasps.active_fingers.tolist() == [[True, True, True, False, False]]
    assert grasps.source.tolist() == ["dgs_net"]

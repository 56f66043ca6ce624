"""Hands and links as triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_description.urdf_parts import palm_link
from dgs_description.urdf_writer import Box, CapsuleShape, Cylinder
from dgs_viewer.shapes import hand_instances, mesh_of
from tests.support.grasps import top_grasps


@pytest.mark.parametrize(
    ("shape", "low", "high"),
    [
        (Box((0.2, 0.1, 0.04), (1.0, 0.0, 0.0)), (0.9, -0.05, -0.02), (1.1, 0.05, 0.02)),
        (Cylinder(0.1, 0.4, (0.0, 0.0, 1.0)), (-0.1, -0.1, 0.8), (0.1, 0.1, 1.2)),
        (CapsuleShape(0.1, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)), (-0.1, -0.1, -0.1), (0.1, 1.1, 0.1)),
    ],
)
def test_a_shape_fills_its_place(shape, low, high):
    vertices, faces = mesh_of([shape])
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=2e-3)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=2e-3)
    assert faces.max() < len(vertices)


def test_hands_stand_where_their_grasps_say():
    grasps = top_grasps(np.array([(0.3, 0.1, 0.0), (0.2, -0.1, 0.05)]))
    placed = hand_instances(grasps, 1.0)
    assert [len(part.positions) for part in placed.values()] == 16 * [2]
    wrist = grasps.position - np.einsum("kij,j->ki", grasps.rotation, HAND.T_base_tcp[:3, 3])
    np.testing.assert_allclose(placed["palm"].positions, wrist, atol=1e-9)
    tip = grasps.pose[1] @ HAND.link_frames(grasps.grasp_joints[1])[4, 3]
    np.testing.assert_allclose(placed["little_distal"].positions[1], tip[:3, 3], atol=1e-9)


def test_the_slider_goes_from_the_pre_grasp_to_the_closed_hand_after_its_motion():
    grasps = replace(top_grasps(np.zeros((1, 3))), motion=np.array([[0.1, 0.0, 0.0]]))
    before, after = hand_instances(grasps, 0.0), hand_instances(grasps, 1.0)
    np.testing.assert_allclose(
        after["palm"].positions - before["palm"].positions, [[0.1, 0.0, 0.0]], atol=1e-9
    )
    open_hand = replace(grasps, grasp_joints=grasps.pre_grasp_joints, motion=np.zeros((1, 3)))
    np.testing.assert_allclose(
        before["index_distal"].positions, hand_instances(open_hand, 1.0)["index_distal"].positions
    )


def test_no_hands_are_no_fault():
    none = top_grasps(np.zeros((1, 3)))[np.array([], int)]
    assert all(part.positions.shape == (0, 3) for part in hand_instances(none, 0.5).values())


def test_the_palm_is_that_of_the_description():
    corners = np.array([[np.subtract(b.centre, np.divide(b.size, 2)), np.add(b.centre, np.divide(b.size, 2))]
                        for b in palm_link().shapes])  # fmt: skip
    vertices, _ = mesh_of(palm_link().shapes)
    np.testing.assert_allclose(vertices.min(axis=0), corners[:, 0].min(axis=0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), corners[:, 1].max(axis=0), atol=1e-6)

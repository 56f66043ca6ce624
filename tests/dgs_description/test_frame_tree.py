"""Chains of static transforms."""

from __future__ import annotations

import numpy as np

from dgs_description.frame_tree import FrameTree
from dgs_description.frames import transform


def test_chain_to_base_link() -> None:
    tree = FrameTree()
    tree.set("camera_link", "/camera_depth_optical_frame", transform(position=(0, 0, 1)))
    assert tree.pose("camera_depth_optical_frame") is None
    tree.set("/base_link", "camera_link", transform(((0, -1, 0), (1, 0, 0), (0, 0, 1)), (1, 0, 0)))
    T_base_optical = tree.pose("/camera_depth_optical_frame")
    assert T_base_optical is not None
    np.testing.assert_allclose(T_base_optical[:3, 3], [1, 0, 1])
    np.testing.assert_allclose(T_base_optical[:3, 0], [0, 1, 0])


def test_base_link_unknown_and_loops() -> None:
    tree = FrameTree()
    np.testing.assert_array_equal(tree.pose("base_link"), np.eye(4))
    assert tree.pose("") is None and tree.pose("nowhere") is None
    tree.set("b", "a", np.eye(4))
    tree.set("a", "b", np.eye(4))
    assert tree.pose("a") is None


def test_frames_above_and_beside_base_link() -> None:
    tree = FrameTree()
    turn = ((0, -1, 0), (1, 0, 0), (0, 0, 1))
    tree.set("world", "base_link", transform(turn, (1, 0, 0)))
    tree.set("world", "camera", transform(position=(1, 2, 0)))
    np.testing.assert_allclose(tree.pose("world"), np.linalg.inv(transform(turn, (1, 0, 0))), atol=1e-12)
    np.testing.assert_allclose(tree.pose("camera")[:3, 3], [2, 0, 0], atol=1e-12)
    tree.set("odom", "other", np.eye(4))
    assert tree.pose("other") is None

"""Poses of links against the closed form of the hand; the arm's are looked at in test_arm_kinematics.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description import urdf_parts
from dgs_description.frames import HAND_TCP
from dgs_description.hand import HAND
from dgs_description.hand_file import LINKS
from dgs_description.link_tree import LinkTree
from dgs_description.urdf import robot


def test_the_fingers_are_where_the_hand_model_says():
    tree, rng = LinkTree(urdf_parts.floating_hand()), np.random.default_rng(1)
    q = rng.uniform(HAND.lower, HAND.upper)
    poses, expected = tree.poses(dict(zip(HAND.joints, q, strict=True))), HAND.link_frames(q)
    assert tree.root == HAND_TCP
    for f, finger in enumerate(HAND.fingers):
        for k, phalanx in enumerate(LINKS):
            np.testing.assert_allclose(poses[f"{finger}_{phalanx}"], expected[f, k], atol=1e-9)


def test_a_coupled_joint_follows_where_it_is_not_named():
    tree = LinkTree(urdf_parts.floating_hand())
    coupled = tree.poses({"index_joint3": 0.7})["index_distal"]
    named = tree.poses({"index_joint3": 0.7, "index_joint4": 0.7})["index_distal"]
    np.testing.assert_allclose(coupled, named)


def test_a_joint_that_hangs_in_the_air_is_refused():
    loose = replace(robot().joints[-1], parent="nowhere", name="loose")
    with pytest.raises(ValueError, match="loose"):
        LinkTree(replace(robot(), joints=(*robot().joints, loose)))

"""Poses and transforms <-> numpy."""

from __future__ import annotations

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.errors import ErrorCode
from dgs_description.frames import from_rpy
from dgs_ros import pose_msgs
from tests.support.refused import refused

angles = st.tuples(*(st.floats(-3.1, 3.1) for _ in range(3)))


@given(angles, angles)
def test_pose_and_transform_there_and_back(position: tuple[float, ...], rpy: tuple[float, ...]) -> None:
    T_a_b = from_rpy(position, rpy)
    np.testing.assert_allclose(pose_msgs.pose_to_matrix(pose_msgs.matrix_to_pose(T_a_b)), T_a_b, atol=1e-12)
    stamped = pose_msgs.matrix_to_transform(T_a_b, "a", "b", Time(sec=7))
    assert (stamped.header.frame_id, stamped.child_frame_id, stamped.header.stamp.sec) == ("a", "b", 7)
    np.testing.assert_allclose(pose_msgs.transform_to_matrix(stamped.transform), T_a_b, atol=1e-12)


def test_points_and_vectors() -> None:
    np.testing.assert_array_equal(pose_msgs.to_array(pose_msgs.to_point([1, 2, 3])), [1, 2, 3])
    np.testing.assert_array_equal(pose_msgs.to_array(pose_msgs.to_vector3(np.float32([1, 2, 3]))), [1, 2, 3])


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (Pose(orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0)), "length 0"),
        (Pose(orientation=Quaternion(x=1.0, y=1.0, z=0.0, w=0.0)), "length 1.414"),
        (Pose(orientation=Quaternion(x=float("nan"), w=1.0)), "not finite"),
        (Pose(position=Point(x=float("inf"))), "not finite"),
    ],
)
def test_poses_that_are_none_are_refused(pose: Pose, words: str) -> None:
    with refused(ErrorCode.POSE_INVALID, words):
        pose_msgs.pose_to_matrix(pose)


def test_a_slightly_long_quaternion_is_taken_as_a_rotation() -> None:
    T = pose_msgs.pose_to_matrix(Pose(orientation=Quaternion(w=1.004)))
    np.testing.assert_allclose(T, np.eye(4), atol=1e-12)

"""JointState <-> numpy by name."""

from __future__ import annotations

import numpy as np
import pytest
from builtin_interfaces.msg import Time

from dgs_description.errors import ErrorCode, JointNameError
from dgs_ros.joint_msgs import efforts_of, has_joints, positions_of, to_joint_state
from tests.support.refused import refused


def test_values_are_found_by_name() -> None:
    msg = to_joint_state(("c", "a", "b"), [3, 1, 2], [30, 10, 20], np.array([300, 100, 200]), Time(sec=5))
    assert msg.header.stamp.sec == 5
    np.testing.assert_array_equal(positions_of(msg, ("a", "b")), [1, 2])
    assert list(msg.velocity) == [30, 10, 20]
    np.testing.assert_array_equal(efforts_of(msg, ("c",)), [300])
    assert has_joints(msg, ("a", "c")) and not has_joints(msg, ("a", "d"))


def test_positions_alone() -> None:
    msg = to_joint_state(("a",), [1])
    assert list(msg.velocity) == list(msg.effort) == []
    with pytest.raises(JointNameError, match="1 joint names came with 0 values"):
        efforts_of(msg, ("a",))


def test_not_a_number_names_the_joint() -> None:
    msg = to_joint_state(("a", "b"), [1.0, float("nan")])
    np.testing.assert_array_equal(positions_of(msg, ("a",)), [1])
    with refused(ErrorCode.JOINT_VALUES, "position of b is not a finite number"):
        positions_of(msg, ("a", "b"))


@pytest.mark.parametrize("values", [[1.0], [1.0, 2.0, 3.0]])
def test_lengths_must_fit(values: list[float]) -> None:
    with pytest.raises(JointNameError):
        to_joint_state(("a", "b"), values)

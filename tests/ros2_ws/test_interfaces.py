"""What the suite asks of foreign interfaces and no other test sends; numbers and sizes that its own leave open."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS is not on this machine")

from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import MoveHand
from dgs_interfaces.msg import Grasp
from ur_dashboard_msgs.msg import SafetyMode
from ur_msgs.srv import SetPayload

FIELDS = [
    (SetPayload.Request, {"mass": "float", "center_of_gravity": "geometry_msgs/Vector3"}),
    (SetPayload.Response, {"success": "boolean"}),
    (SafetyMode, {"mode": "uint8"}),
]


@pytest.mark.parametrize(("message", "fields"), FIELDS, ids=[message.__name__ for message, _ in FIELDS])
def test_fields_and_types(message, fields):
    actual = message.get_fields_and_field_types()
    assert {name: actual.get(name) for name in fields} == fields


def test_error_codes_of_the_trajectory_action():
    result = FollowJointTrajectory.Result
    names = ("SUCCESSFUL", "INVALID_GOAL", "INVALID_JOINTS", "OLD_HEADER_TIMESTAMP")
    assert [getattr(result, name) for name in names] == [0, -1, -2, -3]
    assert (result.PATH_TOLERANCE_VIOLATED, result.GOAL_TOLERANCE_VIOLATED) == (-4, -5)


def test_modes_of_the_hand():
    assert (MoveHand.Goal.MODE_POSITION, MoveHand.Goal.MODE_GRASP) == (0, 1)


@pytest.mark.parametrize("count", [20, 16, 0])
def test_grasps_take_as_many_joints_as_a_hand_has(count: int):
    assert len(Grasp(grasp_joints=[0.1] * count).grasp_joints) == count

"""The interfaces import and carry the fields that the nodes have agreed on."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="ROS is not on this machine")

from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance, JointTrajectoryControllerState
from dgs_interfaces.action import ClearTable, ExecuteGrasp, GoHome, MoveHand
from dgs_interfaces.msg import (
    Grasp,
    GraspArray,
    GraspRejection,
    PickPlan,
    PickRecord,
    SimState,
    StageTime,
    TargetRegion,
)
from dgs_interfaces.srv import InjectFault, PredictGrasps, SimReset
from tf2_msgs.msg import TFMessage
from ur_dashboard_msgs.msg import SafetyMode
from ur_msgs.srv import SetPayload

FIELDS = [
    (
        Grasp,
        {
            "tcp_pose": "geometry_msgs/Pose",
            "score": "float",
            "reference_point": "geometry_msgs/Point",
            "offset": "geometry_msgs/Vector3",
            "hand": "string",
            "pre_grasp_joints": "sequence<double>",
            "grasp_joints": "sequence<double>",
            "active_fingers": "sequence<boolean>",
            "source": "string",
        },
    ),
    (GraspArray, {"header": "std_msgs/Header", "grasps": "sequence<dgs_interfaces/Grasp>"}),
    (
        PickPlan,
        {
            "header": "std_msgs/Header",
            "grasps": "sequence<dgs_interfaces/Grasp>",
            "chosen": "int32",
            "rejections": "sequence<dgs_interfaces/GraspRejection>",
            "stages": "sequence<string>",
            "motions": "sequence<trajectory_msgs/JointTrajectory>",
        },
    ),
    (GraspRejection, {"index": "uint32", "code": "int32", "reason": "string"}),
    (PickRecord, {"source": "string", "error_code": "int32", "message": "string", "success": "boolean"}),
    (
        SimState,
        {"names": "sequence<string>", "poses": "sequence<geometry_msgs/Pose>", "places": "sequence<string>"},
    ),
    (StageTime, {"stage": "string", "seconds": "double"}),
    (
        TargetRegion,
        {"header": "std_msgs/Header", "center": "geometry_msgs/Pose", "size": "geometry_msgs/Vector3"},
    ),
    (
        PredictGrasps.Request,
        {
            "cloud": "sensor_msgs/PointCloud2",
            "max_grasps": "uint32",
            "min_score": "float",
            "target_region": "dgs_interfaces/TargetRegion",
            "target_points": "sequence<geometry_msgs/PointStamped>",
            "keep_out": "sequence<dgs_interfaces/TargetRegion>",
            "seed": "uint64",
        },
    ),
    (
        PredictGrasps.Response,
        {
            "error_code": "int32",
            "message": "string",
            "header": "std_msgs/Header",
            "grasps": "sequence<dgs_interfaces/Grasp>",
            "model_id": "string",
            "model_sha256": "string",
            "points_in": "uint32",
            "points_used": "uint32",
            "stage_times": "sequence<dgs_interfaces/StageTime>",
        },
    ),
    (SimReset.Request, {"seed": "uint64", "objects": "uint32", "catalogue": "string"}),
    (SimReset.Response, {"error_code": "int32", "message": "string"}),
    (InjectFault.Request, {"fault": "string", "target": "string", "duration": "double"}),
    (InjectFault.Response, {"error_code": "int32", "message": "string"}),
    (ExecuteGrasp.Goal, {"header": "std_msgs/Header", "grasps": "sequence<dgs_interfaces/Grasp>"}),
    (
        ExecuteGrasp.Result,
        {
            "error_code": "int32",
            "message": "string",
            "executed_index": "int32",
            "object_held": "boolean",
            "object_released": "boolean",
            "rejections": "sequence<dgs_interfaces/GraspRejection>",
        },
    ),
    (ExecuteGrasp.Feedback, {"stage": "string"}),
    (GoHome.Result, {"error_code": "int32", "message": "string", "object_released": "boolean"}),
    (GoHome.Feedback, {"stage": "string", "progress": "float"}),
    (SetPayload.Request, {"mass": "float", "center_of_gravity": "geometry_msgs/Vector3"}),
    (SetPayload.Response, {"success": "boolean"}),
    (SafetyMode, {"mode": "uint8"}),
    (
        ClearTable.Goal,
        {"max_attempts": "uint32", "seed": "uint64", "target_region": "dgs_interfaces/TargetRegion"},
    ),
    (
        ClearTable.Result,
        {"error_code": "int32", "message": "string", "records": "sequence<dgs_interfaces/PickRecord>"},
    ),
    (ClearTable.Feedback, {"stage": "string", "attempts": "uint32", "successes": "uint32"}),
    (
        MoveHand.Goal,
        {
            "joint_names": "sequence<string>",
            "positions": "sequence<double>",
            "speed": "double",
            "mode": "uint8",
            "active_fingers": "sequence<boolean>",
        },
    ),
    (MoveHand.Result, {"error_code": "int32", "message": "string", "fingers_in_contact": "sequence<string>"}),
    (
        JointTolerance,
        {"name": "string", "position": "double", "velocity": "double", "acceleration": "double"},
    ),
    (FollowJointTrajectory.Goal, {"trajectory": "trajectory_msgs/JointTrajectory"}),
    (FollowJointTrajectory.Result, {"error_code": "int32", "error_string": "string"}),
    (JointTrajectoryControllerState, {"reference": "trajectory_msgs/JointTrajectoryPoint"}),
    (TFMessage, {"transforms": "sequence<geometry_msgs/TransformStamped>"}),
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

"""dgs_interfaces/Grasp and StageTime <-> numpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from dgs_interfaces.msg import Grasp, StageTime

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND, check_hand
from dgs_ros.pose_msgs import matrix_to_pose, pose_to_matrix, to_array, to_point, to_vector3


def grasps_to_msgs(grasps: GraspSet) -> list[Grasp]:
    """One message per grasp, in the given order."""
    poses = grasps.pose
    return [
        Grasp(
            tcp_pose=matrix_to_pose(poses[k]),
            score=float(grasps.score[k]),
            reference_point=to_point(grasps.reference_point[k]),
            offset=to_vector3(grasps.offset[k]),
            hand=HAND.name,
            pre_grasp_joints=grasps.pre_grasp_joints[k].tolist(),
            grasp_joints=grasps.grasp_joints[k].tolist(),
            active_fingers=grasps.active_fingers[k].tolist(),
            motion=to_vector3(grasps.motion[k]),
            drags=bool(grasps.drags[k]),
            source=str(grasps.source[k]),
        )
        for k in range(len(grasps.score))
    ]


def grasps_from_msgs(msgs: Sequence[Grasp]) -> GraspSet:
    """The grasps of K messages; K may be 0. Offset and quality are not read: the one follows, the other is 1.

    Raises:
        DgsError: POSE_INVALID, WRONG_HAND or GRASP_INVALID, with the grasp's index.
    """
    for k, msg in enumerate(msgs):
        check_hand(msg.hand or HAND.name, f"the joints of grasp {k}")
        lengths = len(msg.pre_grasp_joints), len(msg.grasp_joints), len(msg.active_fingers)
        if lengths != (HAND.joint_count, HAND.joint_count, HAND.finger_count):
            wanted = f"{HAND.name} has {HAND.joint_count}, {HAND.joint_count} and {HAND.finger_count}"
            said = f"grasp {k} has {lengths[0]} pre-grasp joints, {lengths[1]} joints and {lengths[2]} flags"
            raise DgsError(ErrorCode.GRASP_INVALID, f"{said}: {wanted}")
    poses = np.empty((len(msgs), 4, 4))
    for k, msg in enumerate(msgs):
        try:
            poses[k] = pose_to_matrix(msg.tcp_pose)
        except DgsError as error:
            raise DgsError(error.code, f"grasp {k}: {error.message}") from error
    numbers = {
        "position": poses[:, :3, 3],
        "rotation": poses[:, :3, :3],
        "pre_grasp_joints": np.array([msg.pre_grasp_joints for msg in msgs]).reshape(-1, HAND.joint_count),
        "grasp_joints": np.array([msg.grasp_joints for msg in msgs]).reshape(-1, HAND.joint_count),
        "score": np.array([msg.score for msg in msgs], dtype=np.float64),
        "reference_point": np.array([to_array(msg.reference_point) for msg in msgs]).reshape(-1, 3),
        "motion": np.array([to_array(msg.motion) for msg in msgs]).reshape(-1, 3),
    }
    for name, values in numbers.items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise DgsError(ErrorCode.GRASP_INVALID, f"grasp {bad[0][0]}: {name} is not finite")
    return GraspSet(
        **numbers,
        active_fingers=np.array([msg.active_fingers for msg in msgs], dtype=bool).reshape(
            -1, HAND.finger_count
        ),
        source=np.array([msg.source for msg in msgs], dtype=np.str_),
        quality=np.ones(len(msgs)),
        drags=np.array([msg.drags for msg in msgs], dtype=bool),
    )


def stage_times_to_msgs(times: Mapping[str, float]) -> list[StageTime]:
    """Messages of seconds by stage name, in the mapping's order."""
    return [StageTime(stage=stage, seconds=float(value)) for stage, value in times.items()]

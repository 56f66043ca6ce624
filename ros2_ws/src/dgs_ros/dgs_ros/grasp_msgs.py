"""dgs_interfaces/Grasp and StageTime <-> numpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from dgs_interfaces.msg import Grasp, StageTime
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_ros.pose_msgs import matrix_to_pose, pose_to_matrix, to_array, to_point, to_vector3

Array = NDArray[np.float64]


class GraspLike(Protocol):
    """Anything with the arrays of `GraspArrays` as attributes, such as the planner's grasp set."""

    @property
    def position(self) -> NDArray:
        """(K, 3) TCP [m]."""

    @property
    def rotation(self) -> NDArray:
        """(K, 3, 3)."""

    @property
    def pre_grasp_joints(self) -> NDArray:
        """(K, 20) [rad]."""

    @property
    def grasp_joints(self) -> NDArray:
        """(K, 20) [rad]."""

    @property
    def score(self) -> NDArray:
        """(K,)."""

    @property
    def reference_point(self) -> NDArray:
        """(K, 3) [m]."""

    @property
    def offset(self) -> NDArray:
        """(K, 3) [m]."""

    @property
    def proposed(self) -> NDArray:
        """(K,) bool."""


class GraspArrays(NamedTuple):
    """K grasps as arrays.

    Attributes:
        position: (K, 3) TCP [m].
        rotation: (K, 3, 3) axes of `hand_tcp`.
        pre_grasp_joints: (K, 20) [rad], order of `HAND_JOINTS`.
        grasp_joints: (K, 20) [rad].
        score: (K,) in [0, 1].
        reference_point: (K, 3) [m].
        offset: (K, 3) position - reference_point [m].
        proposed: (K,) by geometry, not predicted by the network.
    """

    position: Array
    rotation: Array
    pre_grasp_joints: Array
    grasp_joints: Array
    score: Array
    reference_point: Array
    offset: Array
    proposed: NDArray[np.bool_]


def grasps_to_msgs(grasps: GraspLike) -> list[Grasp]:
    """One message per grasp, in the given order."""
    return [
        Grasp(
            tcp_pose=matrix_to_pose(transform(grasps.rotation[k], grasps.position[k])),
            score=float(grasps.score[k]),
            reference_point=to_point(grasps.reference_point[k]),
            offset=to_vector3(grasps.offset[k]),
            pre_grasp_joints=np.asarray(grasps.pre_grasp_joints[k], dtype=np.float64),
            grasp_joints=np.asarray(grasps.grasp_joints[k], dtype=np.float64),
            proposed=bool(grasps.proposed[k]),
        )
        for k in range(len(grasps.score))
    ]


def grasps_from_msgs(msgs: Sequence[Grasp]) -> GraspArrays:
    """Arrays of K messages; K = 0 gives arrays of length 0.

    Raises:
        DgsError: POSE_INVALID or GRASP_INVALID, with the grasp's index, if a number is not finite or a quaternion is
            not of unit length.
    """
    poses = np.empty((len(msgs), 4, 4))
    for k, msg in enumerate(msgs):
        try:
            poses[k] = pose_to_matrix(msg.tcp_pose)
        except DgsError as error:
            raise DgsError(error.code, f"grasp {k}: {error.message}") from error
    arrays = GraspArrays(
        position=poses[:, :3, 3],
        rotation=poses[:, :3, :3],
        pre_grasp_joints=np.array([msg.pre_grasp_joints for msg in msgs], dtype=np.float64).reshape(-1, 20),
        grasp_joints=np.array([msg.grasp_joints for msg in msgs], dtype=np.float64).reshape(-1, 20),
        score=np.array([msg.score for msg in msgs], dtype=np.float64),
        reference_point=np.array([to_array(msg.reference_point) for msg in msgs]).reshape(-1, 3),
        offset=np.array([to_array(msg.offset) for msg in msgs]).reshape(-1, 3),
        proposed=np.array([msg.proposed for msg in msgs], dtype=bool),
    )
    for name, values in arrays._asdict().items():
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise DgsError(ErrorCode.GRASP_INVALID, f"grasp {bad[0][0]}: {name} is not finite")
    return arrays


def stage_times_to_msgs(times: Mapping[str, float]) -> list[StageTime]:
    """Messages of seconds by stage name, in the mapping's order."""
    return [StageTime(stage=stage, seconds=float(value)) for stage, value in times.items()]

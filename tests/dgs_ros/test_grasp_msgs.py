"""Grasp messages <-> arrays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dgs_interfaces.msg import Grasp
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_ros.grasp_msgs import GraspArrays, grasps_from_msgs, grasps_to_msgs, stage_times_to_msgs


def random_grasps(count: int) -> GraspArrays:
    rng = np.random.default_rng(0)
    position, offset = rng.normal(size=(2, count, 3))
    return GraspArrays(
        position=position,
        rotation=Rotation.random(count, rng=rng).as_matrix(),
        pre_grasp_joints=rng.uniform(0, 1, (count, 20)),
        grasp_joints=rng.uniform(0, 1, (count, 20)),
        score=np.linspace(0.9, 0.5, count),
        reference_point=position - offset,
        offset=offset,
        proposed=np.arange(count) % 2 == 1,
    )


def test_there_and_back() -> None:
    grasps = random_grasps(5)
    msgs = grasps_to_msgs(grasps)
    assert all(isinstance(msg, Grasp) for msg in msgs)
    for name, expected, found in zip(GraspArrays._fields, grasps, grasps_from_msgs(msgs), strict=True):
        # The score travels as float32.
        np.testing.assert_allclose(found, expected, atol=1e-7 if name == "score" else 1e-12, err_msg=name)


def test_joint_arrays_are_copied_whole() -> None:
    single = random_grasps(1)
    as_float32 = single._replace(grasp_joints=single.grasp_joints.astype(np.float32))
    np.testing.assert_allclose(grasps_to_msgs(as_float32)[0].grasp_joints, single.grasp_joints[0], atol=1e-6)


def test_no_grasps() -> None:
    assert grasps_to_msgs(random_grasps(0)) == []
    empty = grasps_from_msgs([])
    assert [array.shape for array in empty] == [
        (0, 3),
        (0, 3, 3),
        (0, 20),
        (0, 20),
        (0,),
        (0, 3),
        (0, 3),
        (0,),
    ]


def _zero_quaternion(msg: Grasp) -> None:
    msg.tcp_pose.orientation.w = msg.tcp_pose.orientation.x = 0.0
    msg.tcp_pose.orientation.y = msg.tcp_pose.orientation.z = 0.0


def _nan_joint(msg: Grasp) -> None:
    msg.grasp_joints[7] = np.nan


def _nan_score(msg: Grasp) -> None:
    msg.score = float("nan")


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (_zero_quaternion, ErrorCode.POSE_INVALID, "grasp 2: quaternion"),
        (_nan_joint, ErrorCode.GRASP_INVALID, "grasp 2: grasp_joints is not finite"),
        (_nan_score, ErrorCode.GRASP_INVALID, "grasp 2: score is not finite"),
    ],
)
def test_broken_grasps_are_refused_by_number(
    change: Callable[[Grasp], None], code: ErrorCode, words: str
) -> None:
    msgs = grasps_to_msgs(random_grasps(4))
    change(msgs[2])
    with pytest.raises(DgsError, match=words) as caught:
        grasps_from_msgs(msgs)
    assert caught.value.code == code


def test_stage_times_keep_their_order() -> None:
    msgs = stage_times_to_msgs({"sample": 0.1, "network": np.float32(0.5)})
    assert [(msg.stage, msg.seconds) for msg in msgs] == [("sample", 0.1), ("network", 0.5)]

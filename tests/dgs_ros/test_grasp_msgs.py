"""Grasp messages <-> arrays."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from dgs_interfaces.msg import Grasp
from geometry_msgs.msg import Pose, Quaternion
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.grasp import GraspSet
from dgs_ros.grasp_msgs import grasps_from_msgs, grasps_to_msgs, stage_times_to_msgs
from tests.support.refused import refused


def random_grasps(count: int) -> GraspSet:
    rng = np.random.default_rng(0)
    position, offset = rng.normal(size=(2, count, 3))
    return GraspSet.of(
        "mine",
        position=position,
        rotation=Rotation.random(count, rng=rng).as_matrix() if count else np.zeros((0, 3, 3)),
        pre_grasp_joints=rng.uniform(0, 1, (count, 20)),
        grasp_joints=rng.uniform(0, 1, (count, 20)),
        active_fingers=rng.random((count, 5)) < 0.5,
        score=np.linspace(0.9, 0.5, count),
        reference_point=position - offset,
        motion=rng.normal(size=(count, 3)),
    )


def test_there_and_back() -> None:
    grasps = random_grasps(5)
    msgs = grasps_to_msgs(grasps)
    assert all(isinstance(msg, Grasp) for msg in msgs)
    back = grasps_from_msgs(msgs)
    for field in fields(GraspSet):
        expected, found = getattr(grasps, field.name), getattr(back, field.name)
        if field.name == "source":
            assert found.tolist() == expected.tolist()
        else:  # the score travels as float32
            np.testing.assert_allclose(found, expected, atol=1e-7, err_msg=field.name)
    assert [msg.offset.x for msg in msgs] == pytest.approx(grasps.offset[:, 0].tolist())


def test_a_client_need_not_name_the_hand() -> None:
    (msg,) = grasps_to_msgs(random_grasps(1))
    msg.hand = ""
    assert len(grasps_from_msgs([msg])) == 1


def test_no_grasps() -> None:
    assert grasps_to_msgs(random_grasps(0)) == []
    empty = grasps_from_msgs([])
    for field in fields(GraspSet):
        assert getattr(empty, field.name).shape == getattr(GraspSet.empty(), field.name).shape, field.name


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ({"hand": "allegro"}, ErrorCode.WRONG_HAND, "joints of grasp 2 are for the hand allegro, not for dexhand_pro"),
        ({"grasp_joints": 16 * [0.0]}, ErrorCode.GRASP_INVALID, "2 has 20 pre-grasp joints, 16 joints and 5 flags"),
        ({"tcp_pose": Pose(orientation=Quaternion(w=0.0))}, ErrorCode.POSE_INVALID, "grasp 2: quaternion"),
        ({"grasp_joints": 20 * [np.nan]}, ErrorCode.GRASP_INVALID, "grasp 2: grasp_joints is not finite"),
        ({"score": np.nan}, ErrorCode.GRASP_INVALID, "grasp 2: score is not finite"),
    ],
)  # fmt: skip
def test_broken_grasps_are_refused_by_number(change: dict[str, Any], code: ErrorCode, words: str) -> None:
    msgs = grasps_to_msgs(random_grasps(4))
    for name, value in change.items():
        setattr(msgs[2], name, value)
    with refused(code, words):
        grasps_from_msgs(msgs)


def test_stage_times_keep_their_order() -> None:
    msgs = stage_times_to_msgs({"sample": 0.1, "network": np.float32(0.5)})
    assert [(msg.stage, msg.seconds) for msg in msgs] == [("sample", 0.1), ("network", 0.5)]

"""GraspSet under selection, joining and motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import inverse, transform
from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.network.decode import grasps_from_outputs


def _some(count: int) -> GraspSet:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(count, 12))
    return grasps_from_outputs(
        normal[:, :3],
        rng.random(count),
        normal[:, 3:9],
        normal[:, 9:],
        np.zeros((count, 15)),
        np.zeros((count, 15)),
    )


def test_moving_there_and_back() -> None:
    grasps = _some(5)
    T_a_b = transform(Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix(), (0.1, 0.2, -0.3))
    moved = grasps.moved(T_a_b)
    np.testing.assert_allclose(moved.position, moved.reference_point + moved.offset)
    poses = [T_a_b @ transform(r, p) for r, p in zip(grasps.rotation, grasps.position, strict=True)]
    np.testing.assert_allclose(moved.rotation, [pose[:3, :3] for pose in poses])
    np.testing.assert_allclose(moved.position, [pose[:3, 3] for pose in poses])
    back = moved.moved(inverse(T_a_b))
    np.testing.assert_allclose(back.position, grasps.position, atol=1e-12)
    np.testing.assert_allclose(back.rotation, grasps.rotation, atol=1e-12)


def test_indexing_gives_a_set_or_one_grasp() -> None:
    grasps = _some(5)
    assert len(grasps) == 5 and len(GraspSet.empty()) == 0
    np.testing.assert_array_equal(grasps[[3, 1]].score, grasps.score[[3, 1]])
    assert len(grasps[grasps.score > 2]) == 0 and len(grasps[:2]) == 2
    one = grasps[3]
    assert one.position.shape == (3,) and one.pose.shape == (4, 4) and one.active_fingers.shape == (5,)
    np.testing.assert_array_equal(one.pose, transform(grasps.rotation[3], grasps.position[3]))
    np.testing.assert_array_equal(one.offset, grasps.offset[3])


def test_joining_and_ordering() -> None:
    grasps = _some(5)
    both = joined([grasps[[0, 1]], grasps[[4]], GraspSet.empty()])
    np.testing.assert_array_equal(both.rotation, grasps.rotation[[0, 1, 4]])
    assert both.source.tolist() == ["dgs_net"] * 3 and len(joined([])) == 0
    np.testing.assert_array_equal(grasps[::-1].best_first().score, grasps.score)


def test_a_proposer_states_its_grasps_in_any_leading_shape() -> None:
    joints = np.arange(40.0).reshape(2, 5, 4)
    grasps = GraspSet.of(
        "mine",
        position=np.zeros((2, 3)),
        rotation=np.tile(np.eye(3), (2, 1, 1)),
        pre_grasp_joints=joints,
        grasp_joints=joints,
        active_fingers=[True, True, False, False, False],
        score=[0.5, 0.4],
        reference_point=np.ones((2, 3)),
    )
    assert grasps.grasp_joints.shape == (2, 20) and grasps.active_fingers.shape == (2, 5)
    assert grasps.source.tolist() == ["mine", "mine"] and (grasps.quality == 1).all()
    with pytest.raises(ValueError, match="reshape"):
        GraspSet.of(
            "mine",
            position=np.zeros((2, 3)),
            rotation=np.eye(3),
            pre_grasp_joints=joints,
            grasp_joints=joints,
            active_fingers=np.ones(5),
            score=[1.0, 1.0],
            reference_point=np.ones((2, 3)),
        )


def test_a_motion_turns_with_the_frame_and_moves_the_closing_pose() -> None:
    still = _some(3)
    assert not still.motion.any() and still.motion.shape == (3, 3)
    np.testing.assert_array_equal(still.closing_pose, still.pose)
    grasps = replace(still, motion=np.tile([0.1, 0.0, 0.0], (3, 1)))
    np.testing.assert_allclose(grasps.closing_pose[:, :3, 3] - grasps.position, grasps.motion, atol=1e-15)
    quarter = transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1.0, 0.0, 0.0))
    np.testing.assert_allclose(grasps.moved(quarter).motion, np.tile([0.0, 0.1, 0.0], (3, 1)), atol=1e-15)


def test_pushes_and_drags_hold_nothing() -> None:
    fingers, drags = np.array([[True] * 5, [False] * 5, [True] * 5]), np.array([False, False, True])
    assert replace(_some(3), active_fingers=fingers, drags=drags).holds.tolist() == [True, False, False]

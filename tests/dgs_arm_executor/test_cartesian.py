from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgs_arm_executor.cartesian import MAX_JOINT_STEP, deviation, line_poses, track_line
from dgs_arm_executor.ik import T_TCP_TOOL0, T_TOOL0_TCP, ArmIK
from dgs_arm_executor.timing import time_path
from dgs_description.arm_model import forward_kinematics
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_description.joints import ARM_ACCELERATION, ARM_JERK, ARM_LOWER, ARM_UPPER, ARM_VELOCITY
from tests.support.refused import refused

DOWN = np.diag([1.0, -1.0, -1.0])


def grasp_pose(rng: np.random.Generator) -> np.ndarray:
    tilt = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3))
    return transform(
        (tilt * Rotation.from_euler("z", rng.uniform(0, 6.28))).as_matrix() @ DOWN,
        rng.uniform((0.15, -0.3, -0.12), (0.4, 0.3, 0.0)),
    )


def test_lines_of_random_grasps_are_straight_on_every_branch(ik: ArmIK) -> None:
    rng, driven = np.random.default_rng(3), 0
    for _ in range(5):
        T_start = grasp_pose(rng)
        T_end = T_start @ transform(position=(0, 0, -0.1))
        for q in ik.branches(T_start @ T_TCP_TOOL0)[0]:
            if np.isnan(q[0]):
                continue
            try:
                line = track_line(ik, T_start, T_end, q)
            except DgsError as error:
                assert error.code in (ErrorCode.OUT_OF_REACH, ErrorCode.IK_FAILED, ErrorCode.JOINT_LIMIT)
                continue
            driven += 1
            np.testing.assert_array_equal(line.joints[0], q)
            np.testing.assert_allclose(ik.forward(line.joints[-1]) @ T_TOOL0_TCP, T_end, atol=1e-8)
            assert np.abs(np.diff(line.joints, axis=0)).max() <= MAX_JOINT_STEP
            distance, tilt = deviation(ik, line)
            assert distance < 1e-3 and tilt < np.deg2rad(0.5)
    assert driven > 12


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    branch=st.integers(0, 7),
    approach=st.booleans(),
    share=st.floats(0.05, 1.0),
    tcp_speed=st.floats(0.02, 0.5),
)
def test_any_timed_line_is_straight_within_the_limits_and_at_rest_at_its_ends(
    ik: ArmIK, seed: int, branch: int, approach: bool, share: float, tcp_speed: float
) -> None:
    T_start = grasp_pose(np.random.default_rng(seed))
    q = ik.branches(T_start @ T_TCP_TOOL0)[0][branch]
    if np.isnan(q[0]):
        return
    T_end = (
        T_start @ transform(position=(0, 0, -0.1)) if approach else transform(position=(0, 0, 0.15)) @ T_start
    )
    try:
        line = track_line(ik, T_start, T_end, q)
    except DgsError:
        return  # refused: what is promised is that what is not refused is straight
    trajectory = time_path(line.smooth(), share, 200.0, tcp_speed)
    t, joints, dq, ddq = vars(trajectory).values()
    assert t[0] == 0.0 and (np.diff(t) > 0).all()
    assert (dq[[0, -1]] == 0).all() and (ddq[[0, -1]] == 0).all()
    np.testing.assert_allclose(joints[0], line.joints[0], atol=1e-9)
    np.testing.assert_allclose(joints[-1], line.joints[-1], atol=1e-9)
    assert (joints >= ARM_LOWER).all() and (joints <= ARM_UPPER).all()
    assert (np.abs(dq) <= share * ARM_VELOCITY * (1 + 1e-9)).all()
    assert (np.abs(ddq) <= ARM_ACCELERATION * (1 + 1e-6)).all()
    assert (np.abs(np.diff(ddq, axis=0) / np.diff(t)[:, None]) <= ARM_JERK * 1.005).all()
    # By the description's kinematics, which the planner does not use; at most 60 states of each.
    looked_at = joints[:: max(1, len(joints) // 60)]
    poses = np.array([forward_kinematics(row) @ T_TOOL0_TCP for row in looked_at])
    along = T_end[:3, 3] - T_start[:3, 3]
    direction = along / np.linalg.norm(along)
    off = poses[:, :3, 3] - T_start[:3, 3]
    way = off @ direction
    assert np.linalg.norm(off - way[:, None] * direction, axis=1).max() <= 1e-3
    assert way.min() >= -1e-3 and way.max() <= np.linalg.norm(along) + 1e-3
    assert (np.diff(way) >= -1e-9).all()
    tilt = Rotation.from_matrix(T_start[:3, :3].T @ poses[:, :3, :3]).magnitude()
    assert tilt.max() <= np.deg2rad(0.5)
    speed = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1) / np.diff(t[:: max(1, len(t) // 60)])
    assert speed.max() <= 1.01 * tcp_speed
    back = line.reversed()
    np.testing.assert_array_equal(back.joints[0], line.joints[-1])
    assert back.arc[0] == 0.0 and back.arc[-1] == line.arc[-1]


def test_line_poses_turn_evenly() -> None:
    T_end = transform(Rotation.from_euler("z", 0.8).as_matrix(), (0.1, 0, 0))
    poses = line_poses(np.eye(4), T_end, np.linspace(0.0, 1.0, 9))
    np.testing.assert_allclose(poses[-1], T_end, atol=1e-12)
    angles = Rotation.from_matrix(poses[:, :3, :3]).magnitude()
    assert np.ptp(np.diff(angles)) < 1e-9 and np.ptp(np.diff(poses[:, 0, 3])) < 1e-12


def test_line_out_of_reach_is_refused(ik: ArmIK) -> None:
    T_start = transform(DOWN, (0.3, 0.1, -0.1))
    q = ik.branches(T_start @ T_TCP_TOOL0)[0][0]
    with pytest.raises(DgsError, match="cm") as caught:
        track_line(ik, T_start, transform(position=(0.3, 0, 0)) @ T_start, q)
    # Where the reach ends the elbow is stretched: whichever of the two is met first.
    assert caught.value.code in (ErrorCode.OUT_OF_REACH, ErrorCode.IK_FAILED)


def test_line_through_a_singularity_is_refused(ik: ArmIK) -> None:
    # Over the base the wrist centre crosses the first axis: the shoulder would have to jump by half a turn.
    T_start = transform(DOWN, (0.22, 0.0, 0.25))
    q = ik.states(T_start, np.zeros(6))[0]
    with pytest.raises(DgsError) as caught:
        track_line(ik, T_start, transform(position=(-0.44, 0, 0)) @ T_start, q)
    assert caught.value.code in (ErrorCode.IK_FAILED, ErrorCode.OUT_OF_REACH)


def test_line_beyond_a_joint_limit_is_refused(ik: ArmIK) -> None:
    q = ik.branches(transform(DOWN, (0.3, 0.0, 0.0)) @ T_TCP_TOOL0)[0][0]
    q[5] = ARM_UPPER[5] - 0.05
    T_start = ik.tcp(q)
    with refused(ErrorCode.JOINT_LIMIT, "joint 6 reaches its limit after"):
        track_line(ik, T_start, T_start @ transform(Rotation.from_rotvec((0, 0, 0.2)).as_matrix()), q)

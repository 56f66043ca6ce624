from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_arm_executor.cartesian import MAX_JOINT_STEP, deviation, line_poses, track_line
from dgs_arm_executor.ik import T_TCP_TOOL0, T_TOOL0_TCP, ArmIK
from dgs_arm_executor.timing import Limits, time_path
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform

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


def test_the_timed_motion_stays_on_the_line_too(ik: ArmIK) -> None:
    T_start = transform(DOWN, (0.3, 0.1, -0.1))
    T_end = transform(position=(0, 0, 0.15)) @ T_start
    line = track_line(ik, T_start, T_end, ik.branches(T_start @ T_TCP_TOOL0)[0][0])
    trajectory = time_path(line.smooth(), Limits().scaled(0.6), 125.0, max_path_speed=0.15)
    T_base_tcp = ik.forward_many(trajectory.positions) @ T_TOOL0_TCP
    assert np.abs(T_base_tcp[:, :2, 3] - (0.3, 0.1)).max() < 1e-3
    angles = Rotation.from_matrix(T_base_tcp[:, :3, :3] @ DOWN.T).magnitude()
    assert angles.max() < np.deg2rad(0.5)
    assert (np.diff(T_base_tcp[:, 2, 3]) >= -1e-9).all()
    speed = np.linalg.norm(np.diff(T_base_tcp[:, :3, 3], axis=0), axis=1) / np.diff(trajectory.times)
    assert speed.max() <= 0.15 * 1.01
    back = line.reversed()
    np.testing.assert_array_equal(back.joints[0], line.joints[-1])
    assert back.arc[0] == 0.0 and back.arc[-1] == line.arc[-1]


def test_line_poses_turn_evenly() -> None:
    T_end = transform(Rotation.from_euler("z", 0.8).as_matrix(), (0.1, 0, 0))
    poses, arc = line_poses(np.eye(4), T_end)
    np.testing.assert_allclose(poses[-1], T_end, atol=1e-12)
    angles = Rotation.from_matrix(poses[:, :3, :3]).magnitude()
    assert np.ptp(np.diff(angles)) < 1e-9 and (np.diff(arc) > 0).all()


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
    q = ik.nearest(T_start @ T_TCP_TOOL0, np.zeros(6))
    with pytest.raises(DgsError) as caught:
        track_line(ik, T_start, transform(position=(-0.44, 0, 0)) @ T_start, q)
    assert caught.value.code in (ErrorCode.IK_FAILED, ErrorCode.OUT_OF_REACH)


def test_line_beyond_a_joint_limit_is_refused(ik: ArmIK) -> None:
    T_start = transform(DOWN, (0.3, 0.0, 0.0))
    q = ik.branches(T_start @ T_TCP_TOOL0)[0][0]
    tight = ArmIK(ik.model, lower=q - 0.05, upper=q + 0.05)
    with pytest.raises(DgsError, match="limit after") as caught:
        track_line(tight, T_start, transform(position=(0, 0, 0.15)) @ T_start, q)
    assert caught.value.code == ErrorCode.JOINT_LIMIT

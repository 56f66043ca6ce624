from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dgs_arm_executor.ik import T_TOOL0_TCP, ArmIK, closed_form, dh_forward, nearest_turn
from dgs_arm_executor.robot_geometry import load_robot_geometry
from dgs_description.arm_model import forward_kinematics
from dgs_description.frames import transform
from dgs_description.joints import ARM_JOINTS, ARM_LOWER, ARM_UPPER

joints = st.lists(st.floats(-np.pi, np.pi), min_size=6, max_size=6).map(np.array)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


def test_vectorised_forward_kinematics_is_the_descriptions(ik: ArmIK) -> None:
    for q in np.random.default_rng(0).uniform(-6, 6, (20, 6)):
        np.testing.assert_allclose(dh_forward(q), forward_kinematics(q), atol=1e-12)
        np.testing.assert_allclose(ik.forward(q), forward_kinematics(q), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(joints)
def test_every_branch_reaches_the_pose_and_one_of_them_is_the_posture(ik: ArmIK, q: np.ndarray) -> None:
    T_base_tool0 = dh_forward(q)
    found = ik.branches(T_base_tool0, wrist_3=q[5])[0]
    valid = found[~np.isnan(found[:, 0])]
    for solution in valid:
        np.testing.assert_allclose(ik.forward(solution), T_base_tool0, atol=2e-9)
    if abs(np.sin(q[4])) > 1e-3 and abs(np.sin(q[2])) > 1e-4:
        assert difference(valid, q).max(1).min() < 1e-6


def test_eight_branches_in_the_middle_of_the_workspace(ik: ArmIK) -> None:
    found = ik.branches(transform(np.diag([1.0, -1.0, -1.0]), (0.3, 0.1, 0.05)))[0]
    assert np.isfinite(found).all()
    pairs = [(a, b) for a in range(8) for b in range(a)]
    assert min(difference(found[a], found[b]).max() for a, b in pairs) > 0.1


def test_states_are_within_the_limits_and_turned_next_to_the_given_one(ik: ArmIK) -> None:
    q = np.array([0.4, -1.2, 1.3, -0.6, 1.1, -5.0])
    found = ik.states(dh_forward(q) @ T_TOOL0_TCP, q)
    assert np.abs(found - q).max(1).min() < 1e-9
    assert (found >= ARM_LOWER).all() and (found <= ARM_UPPER).all()
    assert len(found) == np.isfinite(ik.branches(dh_forward(q))[0][:, 0]).sum() > 1
    both = ik.states(np.stack([dh_forward(q) @ T_TOOL0_TCP] * 2), q)
    np.testing.assert_array_equal(both, np.concatenate([found, found]))


def test_no_solution_beyond_reach(ik: ArmIK) -> None:
    assert ik.states(transform(np.eye(3), (0.9, 0.0, 0.2)), np.zeros(6)).shape == (0, 6)


def test_turns() -> None:
    reference = np.array([3.0, -3.0, 0.0, 6.0, 0.0, -6.2])
    turned = nearest_turn(np.array([-3.0, 3.0, 1.0, -0.2, 0.1, 0.2]), reference)
    np.testing.assert_allclose(
        turned, [-3.0 + 2 * np.pi, 3.0 - 2 * np.pi, 1.0, -0.2 + 2 * np.pi, 0.1, 0.2 - 2 * np.pi]
    )
    assert np.isnan(nearest_turn(np.full(6, 20.0), np.full(6, 20.0))).all()


def test_calibrated_robot_is_solved_by_refinement(tmp_path: Path) -> None:
    model, _ = load_robot_geometry().with_hand(np.zeros(20))
    for joint in range(1, model.njoints):
        placement = model.jointPlacements[joint]
        model.jointPlacements[joint] = pin.SE3(
            pin.exp3(np.array([2e-3, -1e-3, 1e-3])) @ placement.rotation, placement.translation + 4e-4
        )
    calibrated = ArmIK(model)
    assert not calibrated.is_dh
    q = np.array([0.4, -1.2, 1.3, -0.6, 1.1, -2.0])
    target = calibrated.forward(q)
    assert np.abs(dh_forward(closed_form(target[None])[0]) - target).max() < 1e-9
    found = calibrated.states(target @ T_TOOL0_TCP, q)
    assert np.abs(found - q).max(1).min() < 1e-6
    assert max(np.abs(calibrated.forward(state) - target).max() for state in found) < 1e-8
    assert len(found) >= 4


def test_joints_are_mapped_by_name(ik: ArmIK) -> None:
    assert [ik.model.names[k + 1] for k in range(6)] == list(ARM_JOINTS)
    step = 1e-6
    q = np.array([0.3, -1.0, 1.2, 0.2, 0.9, -0.4])
    moved = q + np.eye(6) * step
    numeric = [(ik.forward(row)[:3, 3] - ik.forward(q)[:3, 3]) / step for row in moved]
    expected = ik.forward(q)[:3, :3] @ ik.jacobian(q)[:3]
    np.testing.assert_allclose(np.array(numeric).T, expected, atol=1e-5)


def test_manipulability_vanishes_in_a_singularity(ik: ArmIK) -> None:
    stretched = np.array([0.0, -1.0, 0.0, 0.3, 1.0, 0.0])
    assert ik.manipulability(stretched) < 1e-9 < 1e-3 < ik.manipulability(stretched + [0, 0, 1.2, 0, 0, 0])


@pytest.mark.parametrize("wrist_3", [-2.0, 0.0, 1.5])
def test_singular_wrist_keeps_the_last_joint(ik: ArmIK, wrist_3: float) -> None:
    q = np.array([0.4, -1.2, 1.3, -0.6, 0.0, wrist_3])
    found = ik.branches(dh_forward(q), wrist_3=wrist_3)[0]
    valid = found[~np.isnan(found[:, 0])]
    assert difference(valid, q).max(1).min() < 1e-5

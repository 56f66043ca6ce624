import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.joints import HAND_LOWER, HAND_UPPER, expand_active
from dgs_description.pick import CLOSING_MARGIN
from dgs_hand_driver.admittance import (
    STIFFNESS,
    THUMB_FACTOR,
    TIME_CONSTANT,
    AdmittanceController,
    active_fingers,
    closing_target,
)

DT = 1.0 / 240.0
ALL = np.ones(5, dtype=bool)
MIDDLE_POSTURE = np.tile([0.0, 0.5, 0.4, 0.4], 5)


def settle(controller: AdmittanceController, torque: np.ndarray, seconds: float = 2.0) -> np.ndarray:
    for _ in range(round(seconds / DT)):
        controller.step(torque, DT)
    return controller.position


@pytest.mark.parametrize("finger", range(5))
@pytest.mark.parametrize(("joint", "torque"), [(0, 0.3), (1, -0.8), (1, 0.5)])
def test_constant_torque_deflects_by_torque_over_stiffness(finger: int, joint: int, torque: float) -> None:
    controller = AdmittanceController()
    controller.start(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[4 * finger + joint] = torque
    stiffness = STIFFNESS[joint] * (THUMB_FACTOR if finger == 0 else 1.0)
    deflection = settle(controller, external) - MIDDLE_POSTURE
    assert deflection[4 * finger + joint] == pytest.approx(torque / stiffness, abs=1e-6)
    assert np.count_nonzero(np.abs(deflection) > 1e-9) == 1


def test_coupled_pair_balances_the_sum_of_both_torques() -> None:
    controller = AdmittanceController()
    controller.start(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[6], external[7] = -0.5, -0.25
    position = settle(controller, external)
    stiffness = STIFFNESS[2] + STIFFNESS[3]
    assert stiffness * (controller.desired[6] - position[6]) == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize("joint", range(4))
def test_every_joint_has_the_same_time_constant(joint: int) -> None:
    controller = AdmittanceController()
    controller.start(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[8 + joint] = 0.3
    tau = TIME_CONSTANT
    for _ in range(round(tau / 1e-4)):
        controller.step(external, 1e-4)
    after_tau = controller.position[8 + joint] - MIDDLE_POSTURE[8 + joint]
    settled = settle(controller, external)[8 + joint] - MIDDLE_POSTURE[8 + joint]
    assert after_tau / settled == pytest.approx(1 - np.exp(-1), abs=0.01)


@pytest.mark.parametrize("wall", [0.3, 0.6, 0.9])
def test_contact_torque_balances_the_spring(wall: float) -> None:
    controller = AdmittanceController()
    target = closing_target(MIDDLE_POSTURE + np.tile([0, 0.5, 0.2, 0.2], 5), ALL)
    controller.start(np.zeros(20), target, ALL, 1.0)
    external = np.zeros(20)
    for _ in range(round(4.0 / DT)):
        external[5] = -30.0 * max(0.0, controller.position[5] - wall)
        controller.step(external, DT)
    spring = STIFFNESS[1] * (target[5] - controller.position[5])
    np.testing.assert_allclose(controller.desired, target, atol=1e-6)
    assert spring == pytest.approx(-external[5], abs=1e-4)
    assert spring > 0.1


torques = st.lists(st.floats(-5.0, 5.0), min_size=20, max_size=20).map(np.array)
postures = st.lists(st.floats(0.0, 1.0), min_size=15, max_size=15).map(
    lambda share: expand_active(
        np.array(share) * (np.tile((0.5236, 1.48353, 1.134464), 5)) - np.tile((0.2618, 0.0, 0.0), 5)
    ).clip(HAND_LOWER, HAND_UPPER)
)


@given(start=postures, target=postures, torque=torques, speed=st.floats(0.1, 2.09))
def test_limits_coupling_and_speed_hold_under_any_torque(
    start: np.ndarray, target: np.ndarray, torque: np.ndarray, speed: float
) -> None:
    controller = AdmittanceController()
    controller.start(start, target, ALL, speed)
    before = start
    for _ in range(40):
        position = controller.step(torque, DT).copy()
        assert np.all(position >= HAND_LOWER) and np.all(position <= HAND_UPPER)
        assert np.array_equal(position[2::4], position[3::4])
        assert np.abs(position - before).max() <= speed * DT + 1e-9
        before = position


def test_idle_fingers_do_not_comply() -> None:
    controller = AdmittanceController()
    active = np.array([True, True, False, False, True])
    target = MIDDLE_POSTURE + np.tile([0, 0.1, 0.1, 0.1], 5)
    controller.start(MIDDLE_POSTURE, target, active, 1.0)
    position = settle(controller, np.full(20, -0.4)).reshape(5, 4)
    assert np.allclose(position[~active], target.reshape(5, 4)[~active], atol=1e-9)
    assert np.all(position[active] < target.reshape(5, 4)[active] - 0.02)


def test_closing_target_adds_the_margin_to_active_fingers_within_limits() -> None:
    active = np.array([True, False, True, True, True])
    joints = MIDDLE_POSTURE.copy()
    joints[10] = joints[11] = 1.1
    target = closing_target(joints, active).reshape(5, 4)
    yaw, pitch, middle = CLOSING_MARGIN
    assert np.allclose(target[0] - joints[:4], (yaw, pitch, middle, middle))
    assert np.array_equal(target[1], joints[4:8])
    assert target[2, 2] == target[2, 3] == HAND_UPPER[2]


def test_active_fingers_are_those_that_flex() -> None:
    change = np.zeros((5, 4))
    change[0, 0] = 0.2  # yaw alone is no closing
    change[1, 1] = 0.06
    change[2, 2:] = -0.06
    change[3, 1] = 0.04
    moved = active_fingers(MIDDLE_POSTURE, MIDDLE_POSTURE + change.ravel())
    assert moved.tolist() == [False, True, True, False, False]

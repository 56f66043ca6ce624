import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.hand_model import end_ball_jacobian, end_balls
from dgs_description.joints import HAND_EFFORT, HAND_LOWER, HAND_UPPER, expand_active
from dgs_description.pick import CLOSING_MARGIN, closing_limit
from dgs_hand_driver.admittance import (
    SQUEEZE_EFFORT,
    SQUEEZE_FORCE,
    STIFFNESS,
    THUMB_FACTOR,
    TIME_CONSTANT,
    AdmittanceController,
    active_fingers,
    squeeze_torques,
)

DT = 1.0 / 240.0
ALL = np.ones(5, dtype=bool)
MIDDLE_POSTURE = np.tile([0.0, 0.5, 0.4, 0.4], 5)


def settle(controller: AdmittanceController, torque: np.ndarray, seconds: float = 2.0) -> np.ndarray:
    for _ in range(round(seconds / DT)):
        controller.step(torque, DT)
    return controller.position


@pytest.mark.parametrize("finger", range(5))
@pytest.mark.parametrize(("joint", "torque"), [(0, 0.3), (1, -0.8), (1, -0.5)])
def test_constant_torque_deflects_by_torque_over_stiffness(finger: int, joint: int, torque: float) -> None:
    controller = AdmittanceController()
    controller.start(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[4 * finger + joint] = torque
    stiffness = STIFFNESS[joint] * (THUMB_FACTOR if finger == 0 else 1.0)
    deflection = settle(controller, external) - controller.desired
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
    active = np.array([True, True, False, True, True])
    controller.start(MIDDLE_POSTURE, MIDDLE_POSTURE, active, 2.0)
    start = settle(controller, np.zeros(20))[joint + 4]
    external = np.zeros(20)
    external[joint + 4] = 0.3
    for _ in range(round(TIME_CONSTANT / 1e-4)):
        controller.step(external, 1e-4)
    after_tau = controller.position[joint + 4] - start
    settled = settle(controller, external)[joint + 4] - start
    assert after_tau / settled == pytest.approx(1 - np.exp(-1), abs=0.01)


def test_the_squeeze_is_in_balance() -> None:
    active = np.array([True, True, True, True, False])
    torques = squeeze_torques(MIDDLE_POSTURE, active)
    assert not torques[4].any()
    balls = end_balls(MIDDLE_POSTURE)
    forces = np.array(
        [np.linalg.solve(J.T, tau) for J, tau in zip(end_ball_jacobian(MIDDLE_POSTURE), torques, strict=True)]
    )
    assert np.abs(forces.sum(axis=0)).max() < 1e-6
    assert np.abs(np.cross(balls, forces).sum(axis=0)).max() < 1e-6
    assert np.linalg.norm(forces[0]) > 5.0
    load = np.abs(torques) / (HAND_EFFORT.reshape(5, 4)[:, :3] * (1, 1, 2))
    assert load.max() <= SQUEEZE_EFFORT + 1e-9
    assert np.linalg.norm(forces[0]) <= SQUEEZE_FORCE + 1e-6


def test_no_thumb_no_squeeze() -> None:
    assert not squeeze_torques(MIDDLE_POSTURE, [False, True, True, True, True]).any()
    assert not squeeze_torques(MIDDLE_POSTURE, [True, False, False, False, False]).any()


def touch(controller: AdmittanceController, wall: float, seconds: float = 2.0) -> None:
    """Close with a wall before the pitch joint of the index finger."""
    external = np.zeros(20)
    for _ in range(round(seconds / DT)):
        external[5] = -60.0 * max(0.0, controller.position[5] - wall)
        controller.step(external, DT)


@pytest.mark.parametrize("wall", [0.4, 0.5, 0.62])
def test_a_finger_that_meets_something_stops_and_presses(wall: float) -> None:
    controller = AdmittanceController()
    controller.start(np.zeros(20), MIDDLE_POSTURE, ALL, 1.0)
    touch(controller, wall)
    spring = STIFFNESS[1] * (controller.desired[5] - controller.position[5])
    assert wall < controller.position[5] < wall + 0.03
    assert spring == pytest.approx(60.0 * (controller.position[5] - wall), abs=1e-3)
    assert spring > 0.03


def test_fingers_that_meet_nothing_feel_on_to_the_limit() -> None:
    controller = AdmittanceController()
    active = np.array([True, True, False, True, True])
    joints = MIDDLE_POSTURE.copy()
    joints[14] = joints[15] = 1.1
    controller.start(np.zeros(20), joints, active, 2.0)
    limit = closing_limit(joints, active).reshape(5, 4)
    yaw, pitch, middle = CLOSING_MARGIN
    assert np.allclose(limit[0] - joints[:4], (yaw, pitch, middle, middle))
    assert np.array_equal(limit[2], joints[8:12])
    assert limit[3, 2] == limit[3, 3] == HAND_UPPER[2]
    ended = settle(controller, np.zeros(20)).reshape(5, 4)
    assert ended[:, 1:] == pytest.approx(limit[:, 1:], abs=0.01)


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


def test_active_fingers_are_those_that_flex() -> None:
    change = np.zeros((5, 4))
    change[0, 0] = 0.2  # yaw alone is no closing
    change[1, 1] = 0.06
    change[2, 2:] = -0.06
    change[3, 1] = 0.04
    moved = active_fingers(MIDDLE_POSTURE, MIDDLE_POSTURE + change.ravel())
    assert moved.tolist() == [False, True, True, False, False]


PINCH = np.tile([0.0, 0.4, 0.4, 0.4], 5)
PINCH[0] = -0.26
THUMB_AND_MIDDLE = np.array([True, False, True, False, False])


def spring_torques(controller: AdmittanceController) -> np.ndarray:
    """(5, 3) of yaw, pitch and the coupled pair."""
    ahead = (controller.desired - controller.position).reshape(5, 4)[:, :3]
    stiffness = np.tile([*STIFFNESS[:2], STIFFNESS[2:].sum()], (5, 1)) * np.array(
        [[THUMB_FACTOR], *4 * [[1.0]]]
    )
    return np.asarray(ahead * stiffness)


def test_fingers_that_were_stopped_early_end_with_the_balanced_squeeze() -> None:
    controller, met = AdmittanceController(), PINCH - np.tile([0.0, 0.2, 0.2, 0.2], 5)
    controller.start(met - 0.1, PINCH, THUMB_AND_MIDDLE, 2.0)
    for _ in range(round(1.5 / DT)):
        controller.step(-400.0 * (controller.position - met), DT)  # something stiff, in all directions
    touching = np.repeat(THUMB_AND_MIDDLE, 3).reshape(5, 3)
    wanted = squeeze_torques(controller.position, THUMB_AND_MIDDLE)
    assert np.abs(wanted).max() > 0.9
    assert np.abs(spring_torques(controller) - wanted)[touching].max() < 0.05


def test_the_set_points_stand_once_balanced() -> None:
    controller, met = AdmittanceController(), PINCH - np.tile([0.0, 0.2, 0.2, 0.2], 5)
    controller.start(met - 0.1, PINCH, THUMB_AND_MIDDLE, 2.0)
    for _ in range(round(1.5 / DT)):
        controller.step(-400.0 * (controller.position - met), DT)
    stands = controller.desired.copy()
    settle(controller, np.zeros(20))  # what was held is gone
    assert np.allclose(controller.desired, stands)

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dgs_description.hand import HAND
from dgs_description.pick import closing_limit
from dgs_hand_driver import admittance
from dgs_hand_driver.admittance import (
    HOLDING_PERIOD,
    HOLDING_RATE,
    SQUEEZE_EFFORT,
    SQUEEZE_FORCE,
    TIME_CONSTANT,
    AdmittanceController,
    active_fingers,
    squeeze_torques,
)

DT = 1.0 / 240.0
ALL = np.ones(5, dtype=bool)
MIDDLE_POSTURE = np.tile([0.0, 0.5, 0.4, 0.4], 5)


def settle(controller: AdmittanceController, torque: np.ndarray, seconds: float = 12.0) -> np.ndarray:
    for _ in range(round(seconds / DT)):
        controller.step(torque, DT)
    return controller.position


@pytest.mark.parametrize("finger", range(5))
@pytest.mark.parametrize(("joint", "torque"), [(0, 0.3), (1, -0.8), (1, -0.5)])
def test_constant_torque_deflects_by_torque_over_stiffness(finger: int, joint: int, torque: float) -> None:
    controller = AdmittanceController(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[4 * finger + joint] = torque
    stiffness = HAND.grasp.stiffness[joint] * (HAND.grasp.thumb_factor if finger == 0 else 1.0)
    deflection = settle(controller, external) - controller.desired
    assert deflection[4 * finger + joint] == pytest.approx(torque / stiffness, abs=1e-6)
    assert np.count_nonzero(np.abs(deflection) > 1e-6) == 1


def test_coupled_pair_balances_the_sum_of_both_torques() -> None:
    controller = AdmittanceController(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    external = np.zeros(20)
    external[6], external[7] = -0.5, -0.25
    position = settle(controller, external)
    stiffness = HAND.grasp.stiffness[2] + HAND.grasp.stiffness[3]
    assert stiffness * (controller.desired[6] - position[6]) == pytest.approx(0.75, abs=1e-6)


@pytest.mark.parametrize("felt", [0.1, 0.6, 1.2])
@pytest.mark.parametrize("joint", range(4))
def test_every_joint_has_the_same_time_constant_longer_the_more_it_feels(joint: int, felt: float) -> None:
    active = np.array([True, True, False, True, True])
    controller = AdmittanceController(MIDDLE_POSTURE, MIDDLE_POSTURE, active, 2.0)
    start = settle(controller, np.zeros(20))[joint + 4]
    external = np.zeros(20)
    external[joint + 4] = felt * admittance.PRESSING
    damped = 1 + (admittance.CONTACT_DAMPING - 1) * min(felt, 1.0)
    for _ in range(round(damped * TIME_CONSTANT / 1e-3)):
        controller.step(external, 1e-3)
    after_tau = controller.position[joint + 4] - start
    settled = settle(controller, external)[joint + 4] - start
    assert after_tau / settled == pytest.approx(1 - np.exp(-1), abs=0.01)


def test_a_finger_goes_straight_to_its_final_joints_before_it_squeezes() -> None:
    final = MIDDLE_POSTURE
    start = final - np.tile([0.0, 0.3, 0.1, 0.1], 5)
    controller = AdmittanceController(start, final, ALL, 2.0)
    passed = False
    for _ in range(200):
        before = controller.desired.copy()
        controller.step(np.zeros(20), DT)
        assert np.abs(controller.desired - before).max() <= 2.0 * DT + 1e-12
        shares = HAND.split(controller.desired - start)[:, 1:] / (0.3, 0.1, 0.1)
        if not passed:
            np.testing.assert_allclose(shares, np.broadcast_to(shares[:, :1], (5, 3)), atol=1e-9)
        passed |= bool(np.allclose(controller.desired, final))
    assert passed and np.abs(controller.desired - final).max() > 0.1


def test_a_command_that_was_given_does_not_change_any_more() -> None:
    controller = AdmittanceController(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    given = [controller.step(np.zeros(20), DT) for _ in range(400)]
    again = AdmittanceController(MIDDLE_POSTURE, MIDDLE_POSTURE, ALL, 2.0)
    np.testing.assert_array_equal(given, [again.step(np.zeros(20), DT).copy() for _ in range(400)])


def test_the_squeeze_is_in_balance() -> None:
    active = np.array([True, True, True, True, False])
    torques = squeeze_torques(MIDDLE_POSTURE, active)
    assert not torques[4].any()
    balls = HAND.end_balls(MIDDLE_POSTURE)
    forces = np.array(
        [
            np.linalg.solve((J[:, :3] + J[:, 3:] * (0, 0, 1)).T, tau[:3])
            for J, tau in zip(HAND.end_ball_jacobian(MIDDLE_POSTURE)[1], torques, strict=True)
        ]
    )
    assert np.abs(forces.sum(axis=0)).max() < 1e-6
    assert np.abs(np.cross(balls, forces).sum(axis=0)).max() < 1e-6
    assert np.linalg.norm(forces[0]) > 5.0
    load = np.abs(torques[:, :3]) / (HAND.split(HAND.effort)[:, :3] * (1, 1, 2))
    assert load.max() <= SQUEEZE_EFFORT + 1e-9
    assert np.linalg.norm(forces[0]) <= SQUEEZE_FORCE + 1e-6


def test_no_thumb_no_squeeze() -> None:
    assert not squeeze_torques(MIDDLE_POSTURE, [False, True, True, True, True]).any()
    assert not squeeze_torques(MIDDLE_POSTURE, [True, False, False, False, False]).any()


def touch(controller: AdmittanceController, wall: float, seconds: float = 12.0) -> None:
    """Close with a wall before the pitch joint of the index finger."""
    external = np.zeros(20)
    for _ in range(round(seconds / DT)):
        external[5] = -60.0 * max(0.0, controller.position[5] - wall)
        controller.step(external, DT)


@pytest.mark.parametrize("wall", [0.4, 0.5, 0.62])
def test_a_finger_that_meets_something_stops_and_presses(wall: float) -> None:
    controller = AdmittanceController(np.zeros(20), MIDDLE_POSTURE, ALL, 1.0)
    touch(controller, wall)
    spring = HAND.grasp.stiffness[1] * (controller.desired[5] - controller.position[5])
    assert wall < controller.position[5] < wall + 0.03
    assert spring == pytest.approx(60.0 * (controller.position[5] - wall), abs=1e-3)
    assert spring > 0.03


def test_fingers_that_meet_nothing_feel_on_to_the_limit() -> None:
    active = np.array([True, True, False, True, True])
    joints = MIDDLE_POSTURE.copy()
    joints[14] = joints[15] = 1.1
    controller = AdmittanceController(np.zeros(20), joints, active, 2.0)
    limit = HAND.split(closing_limit(joints, active))
    assert np.allclose(limit[0] - joints[:4], HAND.grasp.beyond)
    assert np.array_equal(limit[2], joints[8:12])
    assert limit[3, 2] == limit[3, 3] == HAND.upper[2]
    ended = HAND.split(settle(controller, np.zeros(20)))
    assert ended[:, 1:] == pytest.approx(limit[:, 1:], abs=0.01)


torques = st.lists(st.floats(-5.0, 5.0), min_size=20, max_size=20).map(np.array)
postures = st.lists(st.floats(0.0, 1.0), min_size=15, max_size=15).map(
    lambda share: HAND.expand(
        np.array(share) * (np.tile((0.5236, 1.48353, 1.134464), 5)) - np.tile((0.2618, 0.0, 0.0), 5)
    ).clip(HAND.lower, HAND.upper)
)


@given(start=postures, target=postures, torque=torques, speed=st.floats(0.1, 2.09))
def test_limits_coupling_and_speed_hold_under_any_torque(
    start: np.ndarray, target: np.ndarray, torque: np.ndarray, speed: float
) -> None:
    controller = AdmittanceController(start, target, ALL, speed)
    before = start
    for _ in range(40):
        position = controller.step(torque, DT).copy()
        assert np.all(position >= HAND.lower) and np.all(position <= HAND.upper)
        assert np.array_equal(position[2::4], position[3::4])
        assert np.abs(position - before).max() <= speed * DT + 1e-9
        before = position


def test_idle_fingers_do_not_comply() -> None:
    active = np.array([True, True, False, False, True])
    target = MIDDLE_POSTURE + np.tile([0, 0.1, 0.1, 0.1], 5)
    controller = AdmittanceController(MIDDLE_POSTURE, target, active, 1.0)
    position = HAND.split(settle(controller, np.full(20, -0.4), 2.0))
    assert np.allclose(position[~active], HAND.split(target)[~active], atol=1e-9)
    assert np.all(position[active] < HAND.split(target)[active] - 0.02)


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
    ahead = HAND.split(controller.desired - controller.position)[:, :3]
    stiffness = np.tile([*HAND.grasp.stiffness[:2], HAND.grasp.stiffness[2:].sum()], (5, 1)) * np.array(
        [[HAND.grasp.thumb_factor], *4 * [[1.0]]]
    )
    return np.asarray(ahead * stiffness)


def test_fingers_that_were_stopped_early_end_with_the_balanced_squeeze() -> None:
    met = PINCH - np.tile([0.0, 0.2, 0.2, 0.2], 5)
    controller = AdmittanceController(met - 0.1, PINCH, THUMB_AND_MIDDLE, 2.0)
    for _ in range(round(1.5 / DT)):
        controller.step(-400.0 * (controller.position - met), DT)  # something stiff, in all directions
    touching = np.repeat(THUMB_AND_MIDDLE, 3).reshape(5, 3)
    wanted = squeeze_torques(controller.position, THUMB_AND_MIDDLE)
    assert np.abs(wanted).max() > 0.9
    assert np.abs(spring_torques(controller) - wanted[:, :3])[touching].max() < 0.05


def test_the_set_points_follow_slowly_what_moves_in_the_hand_and_stand_when_it_is_gone() -> None:
    met = PINCH - np.tile([0.0, 0.2, 0.2, 0.2], 5)
    controller = AdmittanceController(met - 0.1, PINCH, THUMB_AND_MIDDLE, 2.0)
    touching = np.repeat(THUMB_AND_MIDDLE, 3).reshape(5, 3)

    def off(seconds: float) -> float:
        """How far the squeeze is off [Nm] after so long against something stiff."""
        for _ in range(round(seconds / DT)):
            controller.step(-400.0 * (controller.position - met), DT)
        wanted = squeeze_torques(controller.position, THUMB_AND_MIDDLE)[:, :3]
        return float(np.abs(spring_torques(controller) - wanted)[touching].max())

    assert off(1.5) < 0.05
    met = met + np.tile([0.0, 0.05, -0.05, -0.05], 5)
    at_first, later = off(0.3), off(2.0)
    assert at_first > 0.2 and later == pytest.approx(at_first * np.exp(-2.0 * HOLDING_RATE), rel=0.1)
    stands = controller.desired.copy()
    settle(controller, np.zeros(20))
    assert np.allclose(controller.desired, stands, atol=0.01)
    met = controller.position.copy() - np.tile([0.0, 0.1, 0.1, 0.1], 5)
    off(HOLDING_PERIOD)  # met again after a long while: no jump
    assert np.allclose(controller.desired, stands, atol=0.05)


@pytest.mark.parametrize(("damping", "steady"), [(1.0, False), (10.0, True)])
def test_one_that_hears_of_a_stiff_wall_late_swings_without_contact_damping(
    damping: float, steady: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(admittance, "CONTACT_DAMPING", damping)
    start, end = np.zeros(20), np.tile([0.0, 0.6, 0.3, 0.3], 5)
    controller = AdmittanceController(start, end, np.ones(5, dtype=bool), 2.0)
    wall, heard, felt = 0.4, deque([np.zeros(20)] * 2), []
    for _ in range(600):
        depth = np.zeros(20)
        depth[5] = max(controller.position[5] - wall, 0.0)
        heard.append(np.minimum(100.0 * depth, HAND.effort))
        controller.step(-heard.popleft(), 0.01)
        felt.append(heard[-1][5])
    assert np.mean(felt[-100:]) > 0.1
    assert (np.ptp(felt[-100:]) < 0.01) == steady

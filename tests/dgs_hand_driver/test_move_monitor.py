"""Ends of a move, decided from states that are written down by hand."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_hand_driver.hand_state import HandState
from dgs_hand_driver.move_monitor import (
    BLOCKED_TIME,
    POSITION_TOLERANCE,
    STILL_TIME,
    TIMEOUT_EXTRA,
    TIMEOUT_FACTOR,
    GraspMove,
    MoveOutcome,
    PositionMove,
)

OPEN = np.zeros(20)
SHUT = np.tile([0.0, 1.0, 0.6, 0.6], 5)
ALL = np.ones(5, dtype=bool)
SPEED = 1.0
INDEX_PITCH, INDEX_MIDDLE = 5, 6


def state(clock: float, positions: np.ndarray, torques: np.ndarray | None = None) -> HandState:
    torque = np.zeros(20) if torques is None else torques
    return HandState(positions, torque, "position", 0, clock, 0.0, round(clock * 100))


def moving(
    start: np.ndarray, target: np.ndarray, speed: float = SPEED, seconds: float = 20.0
) -> Iterator[HandState]:
    for clock in np.arange(0.0, seconds, 0.01):
        step = speed * clock
        yield state(float(clock), start + np.clip(target - start, -step, step))


def end(
    move: PositionMove | GraspMove,
    states: Iterator[HandState],
    change: Callable[[HandState], None] = lambda _: None,
) -> tuple[MoveOutcome, float]:
    """How a move ends, and when."""
    for current in states:
        change(current)
        outcome = move.update(current)
        if outcome is not None:
            return outcome, current.clock
    raise AssertionError("the move did not end")


def shutting(change: Callable[[HandState], None] = lambda _: None) -> tuple[MoveOutcome, float]:
    return end(PositionMove(state(0, OPEN), SHUT, SPEED), moving(OPEN, SHUT), change)


def opening(change: Callable[[HandState], None]) -> tuple[MoveOutcome, float]:
    return end(PositionMove(state(0, SHUT), OPEN, SPEED), moving(SHUT, OPEN), change)


def grasping(
    change: Callable[[HandState], None] = lambda _: None, active: np.ndarray = ALL
) -> tuple[MoveOutcome, float]:
    return end(GraspMove(state(0, OPEN), SHUT, SPEED, active), moving(OPEN, SHUT), change)


def stop_index_at(angle: float, torque: float) -> Callable[[HandState], None]:
    def change(current: HandState) -> None:
        if current.positions[INDEX_PITCH] >= angle:
            current.positions[INDEX_PITCH] = angle
            current.torques[INDEX_PITCH] = torque

    return change


def test_arrives_when_every_joint_is_there() -> None:
    outcome, clock = shutting()
    assert outcome.code == ErrorCode.SUCCESS
    assert clock == pytest.approx(1.0 - POSITION_TOLERANCE, abs=0.015)


def test_target_that_is_reached_already_ends_at_once() -> None:
    move = PositionMove(state(0, SHUT), SHUT, SPEED)
    assert end(move, moving(SHUT, SHUT))[1] == 0.0 and move.progress == 1.0


def test_little_rest_is_accepted_once_still() -> None:
    near = SHUT - 0.05
    near[0::4] = 0.0
    outcome, clock = end(PositionMove(state(0, OPEN), SHUT, SPEED), moving(OPEN, near))
    assert outcome.code == ErrorCode.SUCCESS and "0.050 rad short" in outcome.message
    assert clock > 0.95 + 0.9 * STILL_TIME


def test_push_against_something_is_blocked_quickly() -> None:
    outcome, clock = shutting(stop_index_at(0.4, 1.0))
    assert outcome.code == ErrorCode.HAND_BLOCKED
    assert outcome.fingers_in_contact == ("index",)
    assert "index_joint2 (0.600 rad to go, 1.00 Nm)" in outcome.message
    assert clock == pytest.approx(0.4 + BLOCKED_TIME, abs=0.03)


def test_every_kind_of_joint_has_bounds_of_its_own() -> None:
    def push(current: HandState) -> None:
        current.torques[INDEX_MIDDLE] = 1.0

    for bounds, blocked, touching in (((9, 9, 0.5), True, ("index",)), ((0.5, 0.5, 9), False, ())):
        move = PositionMove(state(0, OPEN), SHUT, SPEED, bounds)
        assert (end(move, moving(OPEN, SHUT), push)[0].code == ErrorCode.HAND_BLOCKED) == blocked
        closing = GraspMove(state(0, OPEN), SHUT, SPEED, ALL, bounds)
        assert end(closing, moving(OPEN, SHUT), push)[0].fingers_in_contact == touching


def test_joint_that_stands_without_pushing_is_blocked_too() -> None:
    outcome, _ = shutting(stop_index_at(0.4, 0.0))
    assert outcome.code == ErrorCode.HAND_BLOCKED and outcome.fingers_in_contact == ("index",)


def test_torque_peak_is_no_contact() -> None:
    def peak(current: HandState) -> None:
        if 0.3 < current.clock < 0.3 + 0.6 * BLOCKED_TIME:
            current.torques[:] = 1.1

    assert shutting(peak)[0].code == ErrorCode.SUCCESS


@pytest.mark.parametrize(("torque", "code"), [(1.1, ErrorCode.SUCCESS), (-1.0, ErrorCode.HAND_BLOCKED)])
def test_opening_minds_what_is_in_the_way_and_not_what_it_leaves_behind(
    torque: float, code: ErrorCode
) -> None:
    def pressed(current: HandState) -> None:
        current.torques[INDEX_PITCH] = torque  # positive in closing direction

    assert opening(pressed)[0].code == code


def test_slow_hand_times_out() -> None:
    outcome, clock = end(PositionMove(state(0, OPEN), SHUT, SPEED), moving(OPEN, SHUT, speed=0.12))
    assert outcome.code == ErrorCode.HAND_TIMEOUT and "joint2" in outcome.message
    assert clock == pytest.approx(TIMEOUT_FACTOR * 1.0 + TIMEOUT_EXTRA, abs=0.02)


def test_slow_move_is_not_still() -> None:
    target = OPEN.copy()
    target[1::4] = 0.1
    outcome, _ = end(PositionMove(state(0, OPEN), target, 0.02), moving(OPEN, target, speed=0.02))
    assert outcome.code == ErrorCode.SUCCESS


def test_progress_runs_from_zero_to_one() -> None:
    move = PositionMove(state(0, OPEN), SHUT, SPEED)
    seen = []
    for current in moving(OPEN, SHUT):
        ended = move.update(current)
        seen.append(move.progress)
        if ended:
            break
    assert seen[0] == 0.0 and seen[-1] > 0.97 and seen == sorted(seen)


def test_grasp_ends_by_contact_and_names_the_fingers() -> None:
    outcome, clock = grasping(stop_index_at(0.4, 0.9))
    assert outcome.code == ErrorCode.SUCCESS
    assert outcome.fingers_in_contact == ("index",)
    # Not before the set point has walked to its end: until then the force still grows.
    assert 1.0 < clock < 1.0 + 3 * STILL_TIME


def test_a_grasp_that_holds_something_makes_progress_all_the_same() -> None:
    def stop_all(current: HandState) -> None:
        current.positions[:] = np.minimum(current.positions, 0.2)

    move = GraspMove(state(0, OPEN), SHUT, SPEED, ALL)
    end(move, moving(OPEN, SHUT), stop_all)
    assert move.progress == 1.0


def test_finger_that_stopped_short_is_in_contact_even_without_torque() -> None:
    assert grasping(stop_index_at(0.9, 0.0))[0].fingers_in_contact == ("index",)


def test_finger_that_feels_something_is_in_contact_whatever_its_joints_say() -> None:
    forces = np.array([[0.29, 5.0], [0.0, 0.0], [0.5, 0.1], [np.nan, np.nan], [0.5, 0.1]])
    active = np.array([True, True, True, True, False])
    for bound, touching in ({}, ("middle",)), ({"contact_force": 0.2}, ("thumb", "middle")):
        states = (replace(current, forces=forces) for current in moving(OPEN, SHUT))
        outcome, _ = end(GraspMove(state(0, OPEN), SHUT, SPEED, active, **bound), states)
        assert outcome.fingers_in_contact == touching


def test_grasp_of_nothing_succeeds_without_contact() -> None:
    outcome, _ = grasping()
    assert outcome.code == ErrorCode.SUCCESS and outcome.fingers_in_contact == ()
    assert "no finger is in contact" in outcome.message


def test_idle_finger_does_not_count_as_contact() -> None:
    active = np.array([True, False, True, True, True])
    assert grasping(stop_index_at(0.4, 0.9), active)[0].fingers_in_contact == ()


def test_grasp_with_nothing_to_flex_says_so() -> None:
    move = GraspMove(state(0, SHUT), SHUT, SPEED, np.zeros(5, dtype=bool))
    outcome, _ = end(move, moving(SHUT, SHUT))
    assert move.progress == 1.0
    assert outcome.code == ErrorCode.SUCCESS and "none closes" in outcome.message


def test_grasp_that_never_comes_to_rest_ends_in_time() -> None:
    def tremble(current: HandState) -> None:
        current.positions[INDEX_MIDDLE] = 0.3 + 0.1 * np.sin(30 * current.clock)
        current.positions[INDEX_MIDDLE + 1] = current.positions[INDEX_MIDDLE]

    outcome, clock = grasping(tremble)
    assert outcome.code == ErrorCode.SUCCESS and "still moving" in outcome.message
    assert clock == pytest.approx(6.0, abs=0.05)


def test_a_hand_that_only_creeps_has_closed() -> None:
    def creep(current: HandState) -> None:
        current.positions[INDEX_MIDDLE] = current.positions[INDEX_MIDDLE + 1] = 0.3 + 0.1 * current.clock

    outcome, clock = grasping(creep)
    assert outcome.code == ErrorCode.SUCCESS and "still moving" not in outcome.message
    assert clock < 1.0 + 3 * STILL_TIME

"""Ends of the way home that no simulation reaches at will: interruptions while the hand opens."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_arm_executor.execution import Report
from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND
from tests.dgs_arm_executor.fake_robot import (
    FINAL,
    GRIPPING,
    JAMMED,
    LIMP,
    OPEN,
    OVER_THE_BIN,
    PRESSING,
    STOPPED,
    FakePlanner,
    FakeRobot,
    execution,
)


def go_home(robot: FakeRobot, blocked: int = 0, room: bool = True) -> Report:
    return execution(robot, FakePlanner(blocked, room)).go_home()


@pytest.mark.parametrize("far", [False, True])
def test_what_hangs_on_the_fingers_is_shaken_off_over_the_bin(far: bool) -> None:
    robot, planner = FakeRobot(None, None), FakePlanner(far=far)
    robot.load, robot.obstructed, planner.nothing_held = None, True, True
    assert execution(robot, planner).go_home().code == ErrorCode.SUCCESS and not robot.obstructed
    over_the_bin = [] if far else ["arm moved", "release"]
    assert robot.done == ["release", "payload of the hand", "carry", *over_the_bin, "home", "arm moved"]
    if not far:
        np.testing.assert_array_equal(robot.opened, HAND.open_hand)
        assert len(robot.shapes) > 4
    execution(robot, planner).go_home()
    assert robot.done.count("carry") == 1, "once"


@pytest.mark.parametrize(("holds", "obstructed"), [(False, False), (True, False), (False, True)])
def test_an_arm_at_home_stays_unless_there_is_something_for_the_bin(holds: bool, obstructed: bool) -> None:
    robot, planner = FakeRobot(None, None), FakePlanner()
    planner.home, planner.nothing_held = OVER_THE_BIN, not holds
    robot.load, robot.obstructed = robot.load if holds else None, obstructed
    report = execution(robot, planner).go_home()
    assert report.code == ErrorCode.SUCCESS and ("carry" in robot.done) == (holds or obstructed)
    if not holds and not obstructed:
        assert report.message == "the arm was at home already" and not robot.done


def resting(joints: np.ndarray, torques: np.ndarray) -> ArmSituation:
    return ArmSituation(OVER_THE_BIN, joints, torques)


def test_what_the_hand_holds_goes_into_the_bin_before_the_arm_goes_home() -> None:
    robot = FakeRobot(None, None)
    report = go_home(robot)
    assert report.code == ErrorCode.SUCCESS and report.object_released and robot.load is None
    assert robot.done == [
        "carry", "payload with object", "arm moved", "release", "payload of the hand", "home", "arm moved",
    ]  # fmt: skip
    assert list(report.stage_times) == ["carry", "release", "home"]
    assert robot.shapes == [True], "it opens, and does not close again"


def test_a_fault_that_swinging_does_not_cure_ends_the_release_at_once() -> None:
    robot = FakeRobot(DgsError(ErrorCode.HAND_INTERNAL, "too hot"), resting(GRIPPING, PRESSING))
    assert go_home(robot).code == ErrorCode.HAND_INTERNAL and robot.shapes == [True]


def test_a_hand_that_holds_nothing_any_more_has_nothing_to_put_into_the_bin() -> None:
    robot = FakeRobot(None, None)
    robot.situation = lambda: ArmSituation(OVER_THE_BIN, OPEN, load=robot.load)  # type: ignore[method-assign]
    report = go_home(robot)
    assert report.code == ErrorCode.SUCCESS and not report.object_released and robot.load is None
    assert robot.done == ["release", "payload of the hand", "home", "arm moved"]


@pytest.mark.parametrize(("room", "shape"), [(True, HAND.open_hand), (False, GRIPPING)], ids=["room", "none"])
def test_an_empty_hand_opens_before_the_way_home_where_it_has_room_else_at_home(
    room: bool, shape: np.ndarray
) -> None:
    robot = FakeRobot(None, None)
    robot.load = None
    assert go_home(robot, room=room).code == ErrorCode.SUCCESS
    np.testing.assert_array_equal(robot.postures[0], shape)
    assert len(robot.postures) == (1 if room else 2) and robot.shapes[-1] is not room, (
        "opens at home at the latest"
    )


@pytest.mark.parametrize("room", [True, False])
def test_a_hand_that_does_not_open_keeps_no_arm_from_home_and_its_fault_is_told(room: bool) -> None:
    robot = FakeRobot(JAMMED, None)
    robot.load = None
    report = go_home(robot, room=room)
    assert report.code == ErrorCode.SUCCESS
    assert report.message == "the arm is at home, but the hand has a fault: jammed"


def test_what_still_falls_and_an_arm_that_still_brakes_are_waited_for() -> None:
    robot = FakeRobot(None, None)
    robot.load = None
    assert go_home(robot, blocked=2).code == ErrorCode.SUCCESS
    assert robot.done[-2:] == ["home", "arm moved"] and robot.looks == 3, "with what is seen by then"


def test_a_way_home_that_stays_blocked_ends_with_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_arm_executor.stages._SETTLING", 0.3)
    report = go_home(FakeRobot(None, None), blocked=10**6)
    assert report.code in (ErrorCode.NO_PATH, ErrorCode.SAFETY_ENVELOPE)
    assert "home: something falls" in report.message


@pytest.mark.parametrize(
    ("trouble", "rest", "free"),
    [
        (STOPPED, resting(GRIPPING, PRESSING), False),
        (STOPPED, resting(GRIPPING, LIMP), True),
        (STOPPED, None, False),
        (JAMMED, resting(OPEN, LIMP), True),
        (JAMMED, resting(GRIPPING, LIMP), False),
    ],
    ids=["stopped, holds", "stopped, dropped out", "stopped, silent", "jammed, open", "jammed, holds"],
)
def test_a_hand_that_is_ended_while_it_opens_is_believed_only_what_it_shows(
    trouble: DgsError, rest: ArmSituation | None, free: bool
) -> None:
    robot = FakeRobot(trouble, rest)
    report = go_home(robot)
    assert report.code == trouble.code and report.message.startswith("release: ")
    assert report.object_released is free and (robot.load is None) is free
    assert ("until /reset" in report.message) == (trouble is STOPPED)
    assert robot.shapes == ([True, *[False, True] * 9] if trouble is JAMMED else [True]), "it tries again"
    assert "home" not in robot.done


def test_an_object_that_was_lost_on_the_way_is_not_reported_as_released() -> None:
    robot = FakeRobot(None, None)
    robot.situation = lambda: ArmSituation(OVER_THE_BIN, FINAL + 0.3, load=robot.load)  # type: ignore[method-assign]
    assert not go_home(robot).object_released and robot.load is None

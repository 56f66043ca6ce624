"""Ends of a pick that no simulation reaches at will."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from dgs_arm_executor.execution import Report
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import PickAnswer, PickPlan, PickSettings, Prepared, Wish
from dgs_arm_executor.situation import ArmSituation, Load
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from tests.dgs_arm_executor.fake_robot import (
    FINAL,
    GRASP,
    GRIPPING,
    OPEN,
    OVER_THE_BIN,
    PRESSING,
    STOPPED,
    FakePlanner,
    FakeRobot,
    Seer,
    execution,
)
from tests.support.grasps import top_grasps
from tests.support.picks import NOTHING


def prepared(grasp: GraspSet, *stages: str, before: ObstacleCloud = NOTHING) -> Prepared:
    """A pick of these stages, planned in 0.1 s."""
    ways = dict.fromkeys(stages, cast(Trajectory, None))
    return Prepared(PickAnswer(PickPlan(0, Load(grasp), ways), ()), before, 0.1)


@pytest.mark.parametrize(
    ("code", "obstructed"), [(ErrorCode.HAND_BLOCKED, True), (ErrorCode.HAND_UNAVAILABLE, False)]
)
def test_an_empty_hand_that_does_not_come_to_its_shape_is_obstructed(
    code: ErrorCode, obstructed: bool
) -> None:
    robot = FakeRobot(None, None)

    def move_hand(*_: object, **__: object) -> None:
        raise DgsError(code, "not there")

    robot.move_hand, robot.candidate, robot.cloud = move_hand, -1, ObstacleCloud()  # type: ignore[attr-defined]
    robot.look = lambda fresh: ArmSituation(OVER_THE_BIN, OPEN)  # type: ignore[method-assign]
    report = execution(robot, FakePlanner()).pick_prepared(prepared(GRASP), Wish())
    assert report.code == code and robot.obstructed == obstructed


class Dragger(FakeRobot):
    """Does all that a drag asks for; `fails`: the stage whose command ends with an error."""

    def __init__(self, fails: str = "", code: ErrorCode = ErrorCode.SUCCESS) -> None:
        super().__init__(None, None)
        self.load, self.candidate, self.cloud = None, -1, ObstacleCloud()
        self.fails, self.code, self.hand = fails, code, list[tuple[str, np.ndarray]]()

    def look(self, fresh: bool) -> ArmSituation:
        return ArmSituation(OVER_THE_BIN, OPEN)

    def move_both(self, trajectory: Trajectory, hand_joints: np.ndarray) -> None:
        self._do(hand_joints)

    def move_hand(self, hand_joints: np.ndarray, closing: object = None, uninterrupted: bool = False) -> None:
        self._do(hand_joints, uninterrupted)

    def move_arm(self, trajectory: Trajectory, hand_joints: np.ndarray, **_: object) -> None:
        self._do(hand_joints)

    def _do(self, hand_joints: np.ndarray, uninterrupted: bool = False) -> None:
        self.hand.append((self.stage, hand_joints))
        if self.stage == self.fails and not uninterrupted:
            raise DgsError(self.code, "on purpose")


class Off(FakePlanner):
    """The measured way off is the planned one."""

    settings = PickSettings()

    def plan_off(self, arm_joints: np.ndarray, plan: PickPlan, stage: str) -> Trajectory:
        return plan.trajectories[stage]

    def plan_shift(self, arm_joints: np.ndarray, shift: np.ndarray) -> Trajectory:
        assert shift[2] > 0 and not shift[:2].any()
        return cast(Trajectory, None)


def drag(robot: Dragger) -> Report:
    grasp = replace(GRASP, motion=np.array([-0.2, 0.0, 0.0]), drags=np.True_)
    pick = prepared(grasp, "transfer", "approach", "advance", "lift", "home")
    return execution(robot, Off()).pick_prepared(pick, Wish())


def test_a_drag_closes_moves_opens_and_goes_home_with_nothing() -> None:
    robot = Dragger()
    report = drag(robot)
    assert report.code == ErrorCode.SUCCESS and "dragged over 200 mm" in report.message
    assert not report.object_held and robot.load is None
    before, closed = GRASP.pre_grasp_joints, GRASP.grasp_joints
    shapes = {"close": closed, "advance": closed, "release": before, "lift": before, "home": before}
    stages = [stage for stage, _ in robot.hand]
    assert stages[-5:] == list(shapes)
    for stage, joints in robot.hand[-5:]:
        np.testing.assert_array_equal(joints, shapes[stage])


@pytest.mark.parametrize("stage", ["close", "advance", "release"])
@pytest.mark.parametrize("code", [ErrorCode.EXECUTION_CANCELLED, ErrorCode.HAND_BLOCKED])
def test_a_drag_that_ends_early_opens_as_it_came_and_no_wider_at_the_table(
    stage: str, code: ErrorCode
) -> None:
    robot = Dragger(stage, code)
    report = drag(robot)
    assert report.code == code and report.message.endswith("the hand is open")
    np.testing.assert_array_equal(robot.hand[-1][1], GRASP.pre_grasp_joints)
    off_the_table = [at for at, _ in robot.hand].count("back_off")
    assert off_the_table == (2 if code == ErrorCode.HAND_BLOCKED else 0), "jammed, it rises and then opens"
    assert robot.obstructed == (stage == "release" and code == ErrorCode.HAND_BLOCKED)


def test_a_drag_whose_controller_ends_it_while_it_presses_has_met_something() -> None:
    robot = Dragger("advance", ErrorCode.TRAJECTORY_ABORTED)
    do = robot._do

    def press(*arguments: Any) -> None:
        for stamp in (1.0, 1.1) if robot.stage == "advance" else ():
            robot.force.measured(np.array([0.0, 0.0, -90.0]), stamp)
        do(*arguments)

    robot._do = press  # type: ignore[method-assign]
    report = drag(robot)
    assert report.code == ErrorCode.FORCE_LIMIT and "90 N" in report.message
    assert "back_off" in [stage for stage, _ in robot.hand]


def test_a_drag_that_meets_too_much_lets_go_on_the_table_and_rises_open() -> None:
    robot = Dragger("advance", ErrorCode.FORCE_LIMIT)
    assert drag(robot).code == ErrorCode.FORCE_LIMIT
    let_go, risen, opened = robot.hand[-3:]
    assert (let_go[0], risen[0], opened[0]) == ("advance", "back_off", "back_off")
    for joints in (let_go[1], opened[1]):
        np.testing.assert_array_equal(joints, GRASP.pre_grasp_joints)


class Carrier(Dragger):
    """Picks an object up and carries it; `lost`: the hand is found empty from a stage on."""

    def __init__(self, fails: str = "", code: ErrorCode = ErrorCode.SUCCESS, lost: str = "") -> None:
        super().__init__(fails, code)
        self.lost = lost
        self.latched = STOPPED if code is ErrorCode.STOPPED else None

    def situation(self) -> ArmSituation:
        gone = self.lost and self.lost in self.done
        return ArmSituation(OVER_THE_BIN, FINAL + 0.3 if gone else GRIPPING, PRESSING, load=self.load)


class Carrying(Off):
    """Plans the way home, too."""

    def plan_home(self, situation: ArmSituation) -> list[None]:
        return [None]


def carry(robot: Carrier, keep_holding: bool = False) -> Report:
    pick = prepared(GRASP, "transfer", "approach", "lift", "carry", "home")
    return execution(robot, Carrying()).pick_prepared(pick, Wish(keep_holding=keep_holding))


def test_what_is_carried_is_released_over_the_bin_and_the_arm_goes_home() -> None:
    robot = Carrier()
    report = carry(robot)
    assert (report.code, report.object_held, report.object_released) == (ErrorCode.SUCCESS, True, True)
    assert robot.load is None and robot.shapes, "the hand has opened"
    stages = ["transfer", "approach", "close", "lift", "carry", "release", "home"]
    assert [stage for stage in robot.done if stage in stages] == stages


@pytest.mark.parametrize("stage", ["lift", "carry"])
@pytest.mark.parametrize(
    "code",
    [
        ErrorCode.EXECUTION_CANCELLED,
        ErrorCode.TRAJECTORY_ABORTED,
        ErrorCode.JOINT_STATES_SILENT,
        ErrorCode.CONTROLLER_UNAVAILABLE,
        ErrorCode.STOPPED,
        ErrorCode.PROTECTIVE_STOP,
    ],
)
def test_a_pick_that_ends_while_it_carries_keeps_holding(stage: str, code: ErrorCode) -> None:
    robot = Carrier(stage, code)
    report = carry(robot)
    assert report.code == code and report.message.startswith(f"{stage}: ")
    assert (report.object_held, report.object_released) == (stage == "carry", False)
    assert robot.load is not None and not robot.shapes, "the hand is not told to open"
    assert robot.hand[-1][0] == stage, "nor to do anything else"
    stopped = {ErrorCode.STOPPED: "until /reset", ErrorCode.PROTECTIVE_STOP: "hold"}
    assert stopped.get(code, "keeps holding") in report.message


def test_a_pick_that_ends_on_the_way_home_has_released_its_object() -> None:
    robot = Carrier("home", ErrorCode.EXECUTION_CANCELLED)
    report = carry(robot)
    assert report.code == ErrorCode.EXECUTION_CANCELLED and report.object_released and robot.load is None
    assert report.message.endswith("the hand is open")


def test_an_object_is_kept_above_the_table_for_who_wishes_it() -> None:
    robot = Carrier()
    report = carry(robot, keep_holding=True)
    assert report.code == ErrorCode.SUCCESS and report.object_held and not report.object_released
    assert robot.load is not None and not robot.shapes
    assert robot.done[-1] == "payload with object" and "carry" not in robot.done


@pytest.mark.parametrize(
    ("gone", "code"), [("close", ErrorCode.NOTHING_HELD), ("carry", ErrorCode.LOST_OBJECT)]
)
def test_a_hand_that_is_found_empty_opens_and_goes_home(gone: str, code: ErrorCode) -> None:
    robot = Carrier(lost=gone)
    report = carry(robot)
    assert report.code == code and not report.object_held and not report.object_released
    assert robot.load is None and robot.shapes
    assert [stage for stage in robot.done if stage in ("carry", "release", "home")][-2:] == [
        "release",
        "home",
    ]
    assert report.message.endswith("the hand is open and the arm at home")


def block(x: float, y: float) -> np.ndarray:
    """Points on a block of 4 cm on the table, as dense as a camera's."""
    grid = np.arange(0.0, 0.04, 0.002)
    return np.array([(x + a, y + b, -0.16) for a in grid for b in grid])


def take_up(before: np.ndarray, now: np.ndarray) -> Report:
    grasp = top_grasps(np.array([0.32, 0.02, -0.15]), final=FINAL)[0]
    pick = prepared(grasp, before=ObstacleCloud.from_points(before))
    return execution(Seer(now), FakePlanner()).pick_prepared(pick, Wish(plan_only=True))


def test_a_prepared_pick_goes_ahead_where_nothing_has_changed() -> None:
    here, far = block(0.3, 0.0), block(0.3, 0.3)
    report = take_up(np.concatenate([here, far]), np.concatenate([here, far]) + 0.003)
    assert report.code == ErrorCode.SUCCESS and report.stage_times["planning"] == 0.1
    gone_far_away = take_up(np.concatenate([here, far]), here)
    assert gone_far_away.code == ErrorCode.SUCCESS


@pytest.mark.parametrize(
    "now",
    [block(0.34, 0.0), np.zeros((0, 3)), np.concatenate([block(0.3, 0.0), block(0.2, -0.3)])],
    ids=["moved", "gone", "another has come"],
)
def test_a_prepared_pick_is_given_up_where_the_table_has_changed(now: np.ndarray) -> None:
    report = take_up(block(0.3, 0.0), now)
    assert report.code == ErrorCode.SCENE_CHANGED and "nothing was moved" in report.message
    assert report.executed_index == -1

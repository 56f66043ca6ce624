"""Ends of a pick that no simulation reaches at will."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from dgs_arm_executor.execution import Report
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import PickAnswer, PickPlan, PickSettings, Prepared, Rejection, Wish
from dgs_arm_executor.situation import ArmSituation, Load
from dgs_arm_executor.timing import Trajectory
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from tests.dgs_arm_executor.fake_robot import (
    FINAL,
    GRASP,
    GRIPPING,
    JAMMED,
    LIMP,
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

REFUSED = (Rejection(0, ErrorCode.OUT_OF_REACH, "too far"),)


def prepared(grasp: GraspSet, *stages: str, before: ObstacleCloud = NOTHING) -> Prepared:
    """A pick of these stages with the second grasp, planned in 0.1 s."""
    still = np.zeros((2, 6))
    ways = dict.fromkeys(stages, Trajectory(np.array([0.0, 0.1]), still, still, still))
    return Prepared(PickAnswer(PickPlan(1, Load(grasp), ways), REFUSED), before, 0.1)


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
    """Does all that a drag asks for.

    `fails`: the codes with which commands of stages end; `presses`: the stage in which the hand presses on something.
    """

    def __init__(self, fails: str = "", code: ErrorCode = ErrorCode.SUCCESS, presses: str = "") -> None:
        super().__init__(None, None)
        self.load, self.candidate, self.cloud = None, -1, ObstacleCloud()
        self.fails, self.presses, self.hand = {fails: code}, presses, list[tuple[str, np.ndarray]]()

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
        for stamp in (1.0, 1.1) if self.stage == self.presses else ():
            self.force.measured(np.array([0.0, 0.0, -90.0]), stamp)
        if self.stage in self.fails and not uninterrupted:
            raise DgsError(self.fails[self.stage], "on purpose")


class Off(FakePlanner):
    """The measured way off is the planned one; `off`: its stages."""

    settings = PickSettings()

    def __init__(self, room: bool = True) -> None:
        super().__init__(room=room)
        self.off: list[str] = []

    def plan_off(self, arm_joints: np.ndarray, plan: PickPlan, stage: str) -> Trajectory:
        self.off.append(stage)
        return plan.trajectories[stage]

    def plan_shift(self, arm_joints: np.ndarray, shift: np.ndarray, pushing: bool = False) -> Trajectory:
        assert pushing or (shift[2] > 0 and not shift[:2].any())
        return cast(Trajectory, None)

    def distance(self, one: np.ndarray, other: np.ndarray) -> float:
        return float(np.abs(one - other).max())


MOTION = np.array([-0.2, 0.0, 0.0])


def drag(robot: Dragger, planner: Off | None = None) -> Report:
    grasp = replace(GRASP, motion=MOTION, drags=np.True_)
    pick = prepared(grasp, "transfer", "approach", "advance", "lift", "home")
    return execution(robot, planner or Off()).pick_prepared(pick, Wish())


def push(robot: Dragger) -> Report:
    grasp = replace(GRASP, motion=MOTION, active_fingers=np.zeros(5, dtype=bool))
    pick = prepared(grasp, "transfer", "approach", "advance", "retreat", "lift", "home")
    return execution(robot, Off()).pick_prepared(pick, Wish())


def test_a_drag_closes_moves_opens_and_goes_home_with_nothing() -> None:
    robot, planner = Dragger(presses="close"), Off()
    report = drag(robot, planner)
    robot.force.check()  # fingers that close may press for a moment
    assert planner.off == ["advance", "lift"], "from where closing has pushed the arm"
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
    robot = Dragger("advance", ErrorCode.TRAJECTORY_ABORTED, presses="advance")
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


@pytest.mark.parametrize(
    ("code", "pushed"), [(ErrorCode.FORCE_LIMIT, True), (ErrorCode.TRAJECTORY_ABORTED, False)]
)
def test_fingers_that_press_on_what_they_have_pushed_leave_it_upwards(code: ErrorCode, pushed: bool) -> None:
    robot = Dragger("retreat", code)
    report = push(robot)
    assert report.code == (ErrorCode.SUCCESS if pushed else code)
    assert ("lift" in robot.done) == pushed


def test_a_push_eases_off_what_it_has_come_down_on_and_goes_on() -> None:
    robot = Dragger("approach", ErrorCode.FORCE_LIMIT)
    assert push(robot).code == ErrorCode.SUCCESS
    assert [stage for stage, _ in robot.hand][-4:] == ["back_off", "advance", "lift", "home"], "no retreat"
    assert robot.done.count("back_off") == 1, "no higher than needed"


def test_a_grasp_that_slides_in_from_outside_does_not_go_on_over_what_it_has_met() -> None:
    robot = Dragger("approach", ErrorCode.FORCE_LIMIT)
    pick = prepared(replace(GRASP, motion=MOTION), "transfer", "approach", "advance", "lift")
    report = execution(robot, Off()).pick_prepared(pick, Wish())
    assert report.code == ErrorCode.FORCE_LIMIT and robot.hand[-1][0] == "back_off"
    assert "advance" not in robot.done


def test_a_stop_while_the_hand_backs_off_is_the_end_that_is_told() -> None:
    robot = Carrier("approach", ErrorCode.FORCE_LIMIT)
    robot.fails["back_off"] = ErrorCode.STOPPED
    report = carry(robot)
    assert report.code == ErrorCode.STOPPED and report.message.endswith("arm and hand hold where they are")
    assert robot.hand[-1][0] == "back_off", "nothing opens"


class Carrier(Dragger):
    """Picks an object up and carries it; `lost`: the stage from which on the hand is in a `state`."""

    latched: DgsError | None = None

    def __init__(self, fails: str = "", code: ErrorCode = ErrorCode.SUCCESS, lost: str = "") -> None:
        super().__init__(fails, code)
        self.lost, self.state = lost, (FINAL + 0.3, PRESSING)
        if code is ErrorCode.STOPPED:
            self.latched = STOPPED

    def situation(self) -> ArmSituation:
        joints, torques = self.state if self.lost and self.lost in self.done else (GRIPPING, PRESSING)
        return ArmSituation(OVER_THE_BIN, joints, torques, load=self.load)


class Carrying(Off):
    """Plans the way home, too."""

    def plan_home(self, situation: ArmSituation) -> list[None]:
        return [None]


def carry(robot: Carrier, keep_holding: bool = False, room: bool = True) -> Report:
    pick = prepared(GRASP, "transfer", "approach", "lift", "carry", "home")
    return execution(robot, Carrying(room)).pick_prepared(pick, Wish(keep_holding=keep_holding))


def test_what_is_carried_is_released_over_the_bin_and_the_arm_goes_home() -> None:
    robot = Carrier()
    robot.obstructed = True  # of an earlier goal
    robot.cloud = ObstacleCloud.from_points(block(-0.02, -0.02) + (0.0, 0.0, 0.1))
    robot.force.measured(np.array([0.0, 0.0, 45.0]), 0.0)  # of a sensor that nobody has set to zero
    assert len(robot.cloud.points)
    report = carry(robot)
    assert (report.code, report.object_held, report.object_released) == (ErrorCode.SUCCESS, True, True)
    assert report.executed_index == robot.candidate == 1 and report.rejections == REFUSED
    assert robot.load is None and robot.shapes, "the hand has opened"
    assert robot.force.eased and not robot.obstructed and not len(robot.cloud.points)
    assert robot.done == [
        "look_again", "pre_grasp", "payload of the hand", "transfer", "approach", "close", "lift", "carry",
        "payload with object", "release", "payload of the hand", "home",
    ]  # fmt: skip
    np.testing.assert_array_equal(robot.hand[-1][1], HAND.open_hand)


def test_a_hand_that_jams_when_the_object_is_out_is_brought_home_and_its_fault_told() -> None:
    robot = Carrier()
    robot.trouble, robot.rest = JAMMED, ArmSituation(OVER_THE_BIN, OPEN, LIMP)
    report = carry(robot)
    assert report.code == ErrorCode.HAND_BLOCKED and report.object_released and robot.load is None
    assert robot.hand[-1][0] == "home" and report.message.endswith("but the hand has a fault: jammed")
    assert robot.done[-2:] == ["payload of the hand", "home"]


@pytest.mark.parametrize("holds", [False, True])
def test_what_the_hand_still_holds_is_dropped_before_the_arm_moves(holds: bool) -> None:
    robot = Carrier("approach", ErrorCode.EXECUTION_CANCELLED)
    robot.load = Load(GRASP) if holds else None
    pick = prepared(GRASP, "transfer", "approach")
    assert pick.answer.plan is not None
    plan = replace(pick.answer.plan, shaping_on_the_way=True)
    execution(robot, Off()).pick_prepared(replace(pick, answer=PickAnswer(plan, REFUSED)), Wish())
    first, then = (["pre_grasp"], ["transfer"]) if holds else (["transfer"], [])
    assert robot.done == ["look_again", *first, "payload of the hand", *then, "approach"]
    assert robot.load is None


@pytest.mark.parametrize("room", [True, False])
def test_a_pick_that_ends_before_the_hand_closes_opens_it_as_wide_as_there_is_room(room: bool) -> None:
    robot = Carrier("transfer", ErrorCode.EXECUTION_CANCELLED)
    assert carry(robot, room=room).message.endswith("the hand is open")
    np.testing.assert_array_equal(robot.hand[-1][1], HAND.open_hand if room else GRASP.pre_grasp_joints)


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
    stopped = {ErrorCode.STOPPED: "they are until /reset", ErrorCode.PROTECTIVE_STOP: "where they are"}
    assert report.message.endswith(stopped.get(code, "keeps holding"))


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


@pytest.mark.parametrize("room", [True, False])
@pytest.mark.parametrize("held", ["no finger", "thumb"])
@pytest.mark.parametrize(
    ("gone", "code"), [("close", ErrorCode.NOTHING_HELD), ("carry", ErrorCode.LOST_OBJECT)]
)
def test_a_hand_that_is_found_empty_opens_and_goes_home(
    gone: str, code: ErrorCode, held: str, room: bool
) -> None:
    robot = Carrier(lost=gone)
    robot.state[0][: 4 * (held == "thumb")] = GRIPPING[0]
    report = carry(robot, room=room)
    assert report.code == code and not report.object_held and not report.object_released
    assert robot.load is None and robot.done[-3:] == ["release", "payload of the hand", "home"]
    np.testing.assert_array_equal(robot.postures[0], HAND.open_hand if room else GRASP.pre_grasp_joints)
    hangs = held == "thumb" and code == ErrorCode.LOST_OBJECT
    assert len(robot.postures) == (7 if hangs else 1), "over the bin it is shaken off"
    assert report.message.endswith(f"(held off: {held}); the hand is open and the arm at home")


def test_fingers_that_stay_bent_but_press_on_nothing_any_more_have_lost_the_object() -> None:
    robot = Carrier(lost="carry")
    robot.state = GRIPPING, LIMP
    assert carry(robot).code == ErrorCode.LOST_OBJECT


def block(x: float, y: float) -> np.ndarray:
    """Points on a block of 4 cm on the table, as dense as a camera's."""
    grid = np.arange(0.0, 0.04, 0.002)
    return np.array([(x + a, y + b, -0.16) for a in grid for b in grid])


def take_up(before: np.ndarray, now: np.ndarray, motion: float = 0.0) -> Report:
    grasp = top_grasps(np.array([0.32, 0.02, -0.15]), final=FINAL)[0]
    pick = prepared(
        replace(grasp, motion=np.array([0.0, motion, 0.0])), before=ObstacleCloud.from_points(before)
    )
    return execution(Seer(now), FakePlanner()).pick_prepared(pick, Wish(plan_only=True))


def test_a_prepared_pick_goes_ahead_where_nothing_has_changed() -> None:
    here, far = block(0.3, 0.0), block(0.3, 0.3)
    report = take_up(np.concatenate([here, far]), np.concatenate([here, far]) + 0.003)
    assert report.code == ErrorCode.SUCCESS and report.stage_times["planning"] == 0.1
    gone_far_away = take_up(np.concatenate([here, far]), here)
    assert gone_far_away.code == ErrorCode.SUCCESS
    beside_the_table = take_up(here, np.concatenate([here, block(0.6, 0.0)]))
    assert beside_the_table.code == ErrorCode.SUCCESS, "where the robot comes and goes"
    assert take_up(np.concatenate([here, far]), here, motion=0.3).code == ErrorCode.SCENE_CHANGED


@pytest.mark.parametrize(
    "now",
    [block(0.34, 0.0), np.zeros((0, 3)), np.concatenate([block(0.3, 0.0), block(0.2, -0.3)])],
    ids=["moved", "gone", "another has come"],
)
def test_a_prepared_pick_is_given_up_where_the_table_has_changed(now: np.ndarray) -> None:
    report = take_up(block(0.3, 0.0), now)
    assert report.code == ErrorCode.SCENE_CHANGED and "nothing was moved" in report.message
    assert report.executed_index == -1

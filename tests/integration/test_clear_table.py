"""The clear_table node as a process, against a planner and an arm that answer by a script."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus
from dgs_interfaces.action import ClearTable, GoHome
from dgs_interfaces.msg import TargetRegion
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import Vector3

from dgs_description.errors import ErrorCode
from tests.support.environment import wait_until
from tests.support.processes import NodeProcess, suite_node
from tests.support.ros_client import RosClient
from tests.support.scripted_cell import FAST, POINTS, ScriptedCell, pick, plan

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def cell_and_node(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[ScriptedCell, NodeProcess, RosClient]]:
    from tests.support.environment import reserved_domain_id

    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id) as client,
        suite_node("clear_table", domain_id, tmp_path_factory.mktemp("clear_table"), FAST) as node,
    ):
        cell = ScriptedCell(client)
        node.wait_ready(cell.task.server_is_ready)
        # What an arm tells before its client is known to it is told to nobody.
        node.wait_ready(lambda: client.node.count_subscribers("/execute_grasp/_action/feedback") > 0)
        yield cell, node, client


@pytest.fixture
def cell(cell_and_node: tuple[ScriptedCell, NodeProcess, RosClient]) -> ScriptedCell:
    scripted = cell_and_node[0]
    scripted.reset()
    return scripted


def test_picks_until_the_table_is_empty_and_captures_anew_each_time(cell: ScriptedCell) -> None:
    cell.plans = [plan(0.2, 0.3), plan(0.3)]
    cell.picks = [pick(index=1), pick(ErrorCode.NOTHING_HELD)]
    outcome = cell.run(seed=3)
    result = outcome.result
    assert (outcome.status, result.error_code) == (GoalStatus.STATUS_SUCCEEDED, 0), result.message
    assert (result.attempts, result.successes) == (2, 1)
    assert [record.error_code for record in result.records] == [0, ErrorCode.NOTHING_HELD]
    assert result.records[0].tcp_pose.position.x == pytest.approx(0.3)
    assert {"capture", "predict", "lift"} <= {stage.stage for stage in result.records[0].stage_times}
    assert [len(goal.grasps) for goal in cell.goals] == [2, 1]
    stages = [feedback.stage for feedback in cell.feedback]
    assert stages.count("approach") == 2 and "predict" in stages
    assert not any(one == next_ for one, next_ in pairwise(cell.feedback))
    assert len({request.seed for request in cell.requests}) == 3
    stamps = [request.cloud.header.stamp for request in cell.requests]
    assert len({(stamp.sec, stamp.nanosec) for stamp in stamps}) == 3
    assert all(request.cloud.width * request.cloud.height == len(POINTS) for request in cell.requests)


def _nothing(cell: ScriptedCell) -> None:
    pass


def _mute(cell: ScriptedCell) -> None:
    cell.mute = True


def _way_home_fails(code: ErrorCode) -> Callable[[ScriptedCell], None]:
    def prepare(cell: ScriptedCell) -> None:
        cell.homings = [GoHome.Result(error_code=int(code), message="no way home")]

    return prepare


def _planner_fails(cell: ScriptedCell) -> None:
    cell.plans = [PredictGrasps.Response(error_code=ErrorCode.WEIGHTS_MISSING, message="train first")]


def _planner_nonsense(cell: ScriptedCell) -> None:
    cell.plans = [plan(float("nan"))]


def _pick_fails(code: ErrorCode, index: int = 0) -> Callable[[ScriptedCell], None]:
    def prepare(cell: ScriptedCell) -> None:
        cell.plans = [plan(0.3)]
        cell.picks = [pick(code, index)]

    return prepare


@pytest.mark.parametrize(
    ("prepare", "goal", "code"),
    [
        (_nothing, {}, ErrorCode.SUCCESS),
        (_pick_fails(ErrorCode.SUCCESS), {"max_attempts": 1}, ErrorCode.TASK_ATTEMPTS_USED_UP),
        (_pick_fails(ErrorCode.STOPPED), {}, ErrorCode.TASK_STOPPED),
        (_pick_fails(ErrorCode.JOINT_STATES_SILENT), {}, ErrorCode.TASK_ARM_FAILED),
        (_way_home_fails(ErrorCode.NO_PATH), {}, ErrorCode.TASK_ARM_FAILED),
        (_way_home_fails(ErrorCode.PROTECTIVE_STOP), {}, ErrorCode.TASK_STOPPED),
        (_planner_fails, {}, ErrorCode.TASK_PLANNER_FAILED),
        (_planner_nonsense, {}, ErrorCode.TASK_PLANNER_FAILED),
        (_mute, {}, ErrorCode.TASK_NO_CLOUD),
        (_pick_fails(ErrorCode.SUCCESS, index=7), {}, ErrorCode.NODE_INTERNAL),
    ],
)
def test_every_end_has_its_code_and_a_sentence(
    cell: ScriptedCell, prepare: Callable[[ScriptedCell], None], goal: dict[str, int], code: ErrorCode
) -> None:
    prepare(cell)
    outcome = cell.run(**goal)
    assert outcome.result.error_code == code, outcome.result.message
    assert len(outcome.result.message) > 10
    assert (outcome.status == GoalStatus.STATUS_SUCCEEDED) == (code == 0)


def test_after_a_fault_the_arm_goes_home_before_the_next_look_and_what_it_carries_counts(
    cell: ScriptedCell,
) -> None:
    cell.plans, cell.picks = [plan(0.2), plan(0.3)], [pick(ErrorCode.TRAJECTORY_ABORTED), pick()]
    cell.homings = [GoHome.Result(), GoHome.Result(object_released=True)]
    result = cell.run().result
    assert result.error_code == 0, result.message
    assert cell.events == ["home", "look", "pick"] * 2 + ["home", "look"]
    assert [record.success for record in result.records] == [True, True]
    assert result.records[0].error_code == ErrorCode.TRAJECTORY_ABORTED


def test_an_object_in_the_bin_counts_although_the_hand_failed_afterwards(cell: ScriptedCell) -> None:
    jammed = pick(ErrorCode.HAND_BLOCKED)
    jammed.object_released = True
    cell.plans, cell.picks = [plan(0.2)], [jammed]
    result = cell.run().result
    assert (result.error_code, result.successes) == (0, 1)
    assert result.records[0].error_code == ErrorCode.HAND_BLOCKED


def test_the_next_grasp_is_looked_for_and_sent_while_the_arm_carries(cell: ScriptedCell) -> None:
    cell.carries, cell.plans, cell.picks = True, [plan(0.2), plan(0.3)], [pick(), pick()]
    result = cell.run().result
    assert (result.error_code, result.attempts, result.successes) == (0, 2, 2), result.message
    overlapped = ["look", "pick", "released"]
    assert cell.events == ["home", "look", "pick", *overlapped, "look", "released", "home"]
    assert all(goal.stay_over_bin for goal in cell.goals)
    assert {"capture", "predict"} <= {stage.stage for stage in result.records[1].stage_times}


def test_the_last_attempt_that_is_allowed_ends_at_home(cell: ScriptedCell) -> None:
    cell.carries, cell.plans, cell.picks = True, [plan(0.2), plan(0.3)], [pick()]
    assert cell.run(max_attempts=1).result.error_code == ErrorCode.TASK_ATTEMPTS_USED_UP
    assert cell.events == ["home", "look", "pick"] and not cell.goals[0].stay_over_bin


def test_the_last_attempt_that_is_allowed_brings_home_what_it_has_left_in_the_hand(
    cell: ScriptedCell,
) -> None:
    cell.plans, cell.picks = [plan(0.2)], [pick(ErrorCode.TRAJECTORY_ABORTED)]
    cell.homings = [GoHome.Result(), GoHome.Result(object_released=True)]
    result = cell.run(max_attempts=1).result
    assert (result.error_code, result.successes) == (ErrorCode.TASK_ATTEMPTS_USED_UP, 1), result.message
    assert cell.events == ["home", "look", "pick", "home"]


def test_a_scene_that_has_changed_is_looked_at_again_from_over_the_bin(cell: ScriptedCell) -> None:
    cell.carries, cell.plans = True, [plan(0.2), plan(0.3), plan(0.4)]
    cell.picks = [pick(), pick(ErrorCode.SCENE_CHANGED, index=-1), pick()]
    result = cell.run().result
    assert (result.error_code, result.attempts) == (0, 2), result.message
    assert cell.events[:7] == ["home", "look", "pick", "look", "pick", "released", "look"]
    assert [round(record.tcp_pose.position.x, 3) for record in result.records] == [0.2, 0.4]


def test_what_was_prepared_is_dropped_when_the_object_was_lost(cell: ScriptedCell) -> None:
    cell.carries, cell.plans = True, [plan(0.2), plan(0.3)]
    cell.picks = [pick(ErrorCode.LOST_OBJECT), pick()]
    cell.drops_follower = True
    result = cell.run().result
    assert (result.error_code, result.attempts, result.successes) == (0, 1, 0), result.message
    assert cell.events[:7] == ["home", "look", "pick", "look", "pick", "released", "refused"]
    assert cell.events[7:9] == ["home", "look"]


def test_nothing_is_sent_behind_a_pick_that_has_failed_while_the_planner_was_asked(
    cell: ScriptedCell,
) -> None:
    cell.carries = cell.ponders = True
    cell.plans, cell.picks = [plan(0.2), plan(0.3)], [pick(ErrorCode.TRAJECTORY_ABORTED), pick()]
    cell.homings = [GoHome.Result(), GoHome.Result(object_released=True)]
    result = cell.run().result
    assert (result.error_code, result.attempts, result.successes) == (0, 1, 1), result.message
    assert cell.events == ["home", "look", "pick", "look", "released", "home", "look"]


def test_a_stop_while_the_next_pick_is_prepared_ends_the_run(cell: ScriptedCell) -> None:
    cell.carries, cell.plans, cell.picks = True, [plan(0.2), plan(0.3)], [pick(ErrorCode.STOPPED)]
    cell.drops_follower = True
    assert cell.run().result.error_code == ErrorCode.TASK_STOPPED
    assert cell.events == ["home", "look", "pick", "look", "pick", "released", "refused"]


def test_a_cancel_ends_the_pick_and_the_one_that_was_prepared(
    cell: ScriptedCell, cell_and_node: tuple[ScriptedCell, NodeProcess, RosClient]
) -> None:
    client = cell_and_node[2]
    cell.carries = cell.held = True
    cell.plans, cell.picks = [plan(0.2), plan(0.3)], [pick()]
    handle = cell.start()
    result = handle.get_result_async()
    wait_until(lambda: len(cell.goals) == 2)
    client.wait(handle.cancel_goal_async())
    outcome = client.wait(result)
    assert outcome.result.error_code == ErrorCode.TASK_CANCELLED
    assert outcome.result.attempts == 1
    assert sorted(cell.events[5:]) == ["released", "withdrawn"]


def test_cancel_stops_the_arm_and_a_second_goal_meanwhile_is_busy(
    cell: ScriptedCell, cell_and_node: tuple[ScriptedCell, NodeProcess, RosClient]
) -> None:
    client = cell_and_node[2]
    cell.plans, cell.hold = [plan(0.3)], True
    handle = cell.start()
    result = handle.get_result_async()
    wait_until(lambda: cell.goals)
    assert cell.run().result.error_code == ErrorCode.TASK_BUSY
    client.wait(handle.cancel_goal_async())
    outcome = client.wait(result)
    assert outcome.status == GoalStatus.STATUS_CANCELED
    assert outcome.result.error_code == ErrorCode.TASK_CANCELLED
    assert cell.cancelled
    assert outcome.result.attempts == 1  # the cancelled one is on the record


def test_a_planner_that_went_before_it_is_asked_is_waited_for(
    cell: ScriptedCell, cell_and_node: tuple[ScriptedCell, NodeProcess, RosClient]
) -> None:
    client = cell_and_node[2]
    cell.mute = True
    result = cell.start().get_result_async()
    wait_until(lambda: "home" in cell.events)
    client.node.destroy_service(cell.planner)
    time.sleep(0.5)  # the news of it must not come after the cloud
    cell.mute = False
    wait_until(lambda: "predict" in [feedback.stage for feedback in cell.feedback])
    cell.offer_planner()
    assert client.wait(result).result.error_code == 0
    assert len(cell.requests) == 1


def test_missing_servers_are_named_and_sigint_in_the_middle_of_work_is_clean(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    with suite_node("clear_table", ros_domain_id, tmp_path, FAST) as node:
        empty = ros_client.run_action(ClearTable, "/clear_table", ClearTable.Goal())
        assert empty.result.error_code == ErrorCode.TASK_PLANNER_UNAVAILABLE
        cell = ScriptedCell(ros_client, with_arm=False)
        assert cell.run().result.error_code == ErrorCode.TASK_ARM_UNAVAILABLE
        cell.add_arm()
        cell.plans, cell.hold = [plan(0.3)], True
        cell.start()
        wait_until(lambda: cell.goals)
        assert node.interrupt() == 0
        wait_until(lambda: cell.cancelled)  # the arm was not left to itself


def test_a_target_region_is_passed_on_to_the_planner(cell: ScriptedCell) -> None:
    region = TargetRegion(size=Vector3(x=0.1, y=0.2, z=0.3))
    region.header.frame_id = "base_link"
    cell.run(target_region=region)
    assert [request.target_region for request in cell.requests] == [region]
    cell.run()
    assert cell.requests[-1].target_region == TargetRegion()

"""The table-clearing protocol: attempts, places, ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_bringup.clear_table import MAX_CANDIDATES, ClearTable, Next
from dgs_bringup.clear_table import ClearTableParameters as Settings
from dgs_description.errors import ErrorCode
from dgs_description.grasp import GraspSet, joined

OK = ErrorCode.SUCCESS
MISSED = ErrorCode.NOTHING_HELD


def grasps(*points: tuple[float, float]) -> GraspSet:
    xyz = np.array([(x, y, -0.15) for x, y in points]).reshape(-1, 3)
    count = len(xyz)
    return GraspSet.of(
        "level_pinch",
        position=xyz + (0, 0, 0.05),
        rotation=np.tile(np.eye(3), (count, 1, 1)),
        pre_grasp_joints=np.zeros((count, 20)),
        grasp_joints=np.zeros((count, 20)),
        active_fingers=np.ones((count, 5), bool),
        score=np.linspace(0.95, 0.8, count),
        reference_point=xyz,
    )


def push(x: float, way: float) -> GraspSet:
    return replace(
        grasps((x, 0.0)), active_fingers=np.zeros((1, 5), bool), motion=np.array([[way, 0.0, 0.0]])
    )


def attempt(task: ClearTable, offered: GraspSet | tuple[float, float], code: int = MISSED):
    """Execute the best of what is offered, or a grasp at a point."""
    step = task.after_prediction(OK, "", offered if isinstance(offered, GraspSet) else grasps(offered))
    assert step.next is Next.EXECUTE
    return task.after_execution(code, "sentence", step.indices[0])


@pytest.fixture
def task() -> ClearTable:
    return ClearTable(Settings(), seed=0)


def test_three_failures_at_a_place_give_it_up_and_drop_the_grasps_around_it(task: ClearTable):
    for x in (0.30, 0.31, 0.32):
        assert attempt(task, (x, 0.0)).next is Next.CAPTURE
    step = task.after_prediction(OK, "", grasps((0.32, 0.05), (0.32, 0.07), (0.5, 0.2)))
    assert step.indices == (1, 2)  # 5 cm away is dropped, 7 cm is not


def test_grasps_that_failed_are_remembered_and_no_others(task: ClearTable):
    for x, code in ((0.30, MISSED), (0.40, OK), (0.50, ErrorCode.HAND_BLOCKED)):
        attempt(task, (x, 0.0), code)
    np.testing.assert_allclose(task.failed.poses[:, :3, 3], [(0.3, 0, -0.1), (0.5, 0, -0.1)])


def test_a_place_moves_along_with_a_pushed_object(task: ClearTable):
    for x in (0.30, 0.35, 0.40):  # 10 cm in all, 5 cm a push
        attempt(task, (x, 0.0))
    assert [place.failures for place in task.places] == [3]
    assert task.after_prediction(OK, "", grasps((0.40, 0.0))).next is Next.CAPTURE


def test_a_push_is_no_grasp_and_where_it_was_pushed_often_it_may_still_be_grasped(task: ClearTable):
    for x in (0.50, 0.45, 0.40, 0.35, 0.30, 0.25):
        assert not task.given_up
        assert attempt(task, push(x, -0.05), OK).next is Next.CAPTURE
    assert (task.attempts, task.pushes, task.records) == (0, 6, [])
    (place,) = task.given_up
    np.testing.assert_allclose(place.position[:2], (0.2, 0.0))
    assert task.summary() == "0 of 0 grasps succeeded, 6 pushes, 1 place given up"
    assert task.after_prediction(OK, "", push(0.2, -0.1)).next is Next.CAPTURE
    for failures in (1, 2, 3):
        attempt(task, (0.2, 0.0))
        assert (task.places[0].failures, task.places[0].pushes) == (failures, 6)
    assert task.after_prediction(OK, "", grasps((0.2, 0.0))).next is Next.CAPTURE


def test_where_pushes_end_early_nothing_is_pushed_after_three(task: ClearTable):
    for _ in range(3):
        assert attempt(task, push(0.50, -0.2), ErrorCode.FORCE_LIMIT).next is Next.CAPTURE
    (place,) = task.places
    assert place.position[0] == 0.50, "it lies where it lay"
    assert task.after_prediction(OK, "", push(0.50, -0.2)).next is Next.CAPTURE


def test_what_was_pushed_and_then_lifted_leaves_no_place(task: ClearTable):
    attempt(task, push(0.50, -0.2), OK)
    attempt(task, (0.3, 0.0), OK)
    assert task.places == [] and (task.attempts, task.successes, task.pushes) == (1, 1, 1)


def test_failures_at_different_places_are_counted_apart(task: ClearTable):
    for y in (-0.3, 0.0, 0.3):
        attempt(task, (0.3, y))
    assert sorted(place.failures for place in task.places) == [1, 1, 1]
    assert not task.given_up


def test_a_failure_between_two_places_counts_at_the_nearer_one(task: ClearTable):
    for x in (0.30, 0.37, 0.35):
        attempt(task, (x, 0.0))
    assert [(place.position[0], place.failures) for place in task.places] == [(0.30, 1), (0.35, 2)]


def test_a_success_clears_the_memory_of_its_place(task: ClearTable):
    attempt(task, (0.3, 0.0))
    attempt(task, (0.3, 0.01))
    attempt(task, (0.3, 0.0), OK)
    attempt(task, (0.3, 0.0))
    assert [place.failures for place in task.places] == [1]
    assert (task.attempts, task.successes) == (4, 1)


def test_the_run_ends_when_the_planner_sees_no_object(task: ClearTable):
    step = task.after_prediction(ErrorCode.NO_OBJECTS, "only the table", grasps())
    assert (step.next, step.code) == (Next.END, OK)


@pytest.mark.parametrize(
    ("code", "end"),
    [(ErrorCode.NO_GRASP, OK), (ErrorCode.PLANNER_BUSY, ErrorCode.TASK_PLANNER_FAILED)],
)
def test_looks_without_a_grasp_end_the_run_only_in_a_row(code, end):
    task = ClearTable(Settings(idle_rounds=3), 0)
    assert [task.after_prediction(code, "", grasps()).next for _ in range(2)] == [Next.CAPTURE] * 2
    attempt(task, (0.3, 0.0), OK)
    steps = [task.after_prediction(code, "", grasps()) for _ in range(3)]
    assert [step.next for step in steps] == [Next.CAPTURE, Next.CAPTURE, Next.END]
    assert steps[-1].code == end


def test_unreachable_candidates_are_followed_by_the_next_ones_without_counting_an_attempt():
    task = ClearTable(Settings(idle_rounds=1), 0)
    first = task.after_prediction(OK, "", grasps(*[(0.3, 0.01 * k) for k in range(MAX_CANDIDATES + 1)]))
    second = task.after_execution(ErrorCode.NO_FEASIBLE_GRASP, "out of reach", -1)
    assert (first.indices, second.next) == (tuple(range(MAX_CANDIDATES)), Next.EXECUTE)
    assert second.indices == (MAX_CANDIDATES,)
    assert task.after_execution(ErrorCode.NO_FEASIBLE_GRASP, "out of reach", -1).next is Next.END
    assert task.attempts == 0


def test_sentences_have_the_right_number():
    task = ClearTable(Settings(failures_per_place=1, idle_rounds=1), 0)
    assert task.after_prediction(OK, "", grasps((0.3, 0.0))).message == "1 grasp, best score 0.95"
    attempt(task, (0.3, 0.0))
    assert task.summary() == "0 of 1 grasp succeeded, 1 place given up"
    end = task.after_prediction(OK, "", grasps((0.3, 0.0)))
    assert "1 look: 1 grasp, only at places" in end.message


@pytest.mark.parametrize("first", [grasps((0.3, 0.0)), push(0.3, 0.1)], ids=["grasp", "push"])
def test_attempts_are_limited(first: GraspSet):
    task = ClearTable(Settings(max_attempts=2), 0)
    assert attempt(task, first, OK).next is Next.CAPTURE and task.on_the_last_attempt
    step = attempt(task, (0.3, 0.2), OK)
    assert (step.next, step.code) == (Next.END, ErrorCode.TASK_ATTEMPTS_USED_UP)


@pytest.mark.parametrize(
    ("planner_code", "task_code"),
    [
        (ErrorCode.CLOUD_EMPTY, ErrorCode.TASK_NO_CLOUD),
        (ErrorCode.CLOUD_NO_TABLE, ErrorCode.TASK_NO_CLOUD),
        (ErrorCode.CLOUD_STALE, ErrorCode.TASK_NO_CLOUD),
        (ErrorCode.WEIGHTS_MISSING, ErrorCode.TASK_PLANNER_FAILED),
        (ErrorCode.PLANNER_INTERNAL, ErrorCode.TASK_PLANNER_FAILED),
        (9999, ErrorCode.TASK_PLANNER_FAILED),
    ],
)
def test_planner_errors_end_the_run_with_its_sentence(task: ClearTable, planner_code, task_code):
    step = task.after_prediction(planner_code, "do this", grasps())
    assert (step.next, step.code) == (Next.END, task_code)
    assert "do this" in step.message


@pytest.mark.parametrize(
    ("arm_code", "task_code"),
    [
        (ErrorCode.STOPPED, ErrorCode.TASK_STOPPED),
        (ErrorCode.PROTECTIVE_STOP, ErrorCode.TASK_STOPPED),
        (ErrorCode.JOINT_STATES_SILENT, ErrorCode.TASK_ARM_FAILED),
        (ErrorCode.HAND_BUS, ErrorCode.TASK_ARM_FAILED),
        (ErrorCode.OBSTACLES_MISSING, ErrorCode.TASK_NO_CLOUD),
        (ErrorCode.OBSTACLES_STALE, ErrorCode.TASK_NO_CLOUD),
        (9999, ErrorCode.TASK_ARM_FAILED),
    ],
)
def test_arm_errors_end_the_run_and_the_attempt_is_recorded(task: ClearTable, arm_code, task_code):
    step = attempt(task, (0.3, 0.0), arm_code)
    assert (step.next, step.code) == (Next.END, task_code)
    assert [(record.code, record.success) for record in task.records] == [(arm_code, False)]


@pytest.mark.parametrize(
    "code",
    [
        ErrorCode.TRAJECTORY_ABORTED,
        ErrorCode.SAFETY_ENVELOPE,
        ErrorCode.HAND_BUSY,
        ErrorCode.HAND_CANCELLED,
    ],
)
def test_repeated_hardware_faults_end_the_run_but_one_does_not(code):
    task = ClearTable(Settings(max_faults=2), 0)
    assert attempt(task, (0.3, 0.0), code).next is Next.CAPTURE
    assert attempt(task, (0.3, 0.2), MISSED).next is Next.CAPTURE
    assert attempt(task, (0.3, 0.0), ErrorCode.HAND_TIMEOUT).next is Next.CAPTURE
    assert attempt(task, (0.3, 0.2), ErrorCode.TRAJECTORY_ABORTED).code == ErrorCode.TASK_ARM_FAILED


def test_records_say_what_was_executed(task: ClearTable):
    candidates = grasps((0.3, 0.0), (0.4, 0.1))
    task.after_prediction(OK, "", candidates)
    task.after_execution(OK, "placed", 1, {"predict": 0.5})
    (record,) = task.records
    assert (record.attempt, record.success, record.stage_times) == (1, True, {"predict": 0.5})
    assert record.grasp.score == candidates.score[1] and record.grasp.source == "level_pinch"
    assert np.array_equal(record.grasp.pose[:3, 3], candidates.position[1])


def test_seeds_differ_from_look_to_look_and_repeat_from_run_to_run():
    runs = [ClearTable(Settings(), seed) for seed in (7, 7, 0)]
    first, second, other = ([run.next_seed() for _ in range(5)] for run in runs)
    assert len(set(first)) == 5
    assert first == second != other


def test_what_the_arm_brings_to_the_bin_on_its_way_home_counts_for_the_last_attempt(task: ClearTable):
    attempt(task, (0.3, 0.0), ErrorCode.TRAJECTORY_ABORTED)
    assert task.after_homing(OK, "at home", released=True) is None
    assert task.successes == 1 and task.records[0].code == ErrorCode.TRAJECTORY_ABORTED
    assert task.places == [] and not len(task.failed.poses)


def test_what_an_earlier_run_has_left_in_the_hand_counts_for_no_attempt(task: ClearTable):
    assert task.after_homing(OK, "at home", released=True) is None and task.successes == 0


def test_a_failed_way_home_ends_the_run(task: ClearTable):
    stopped = task.after_homing(ErrorCode.STOPPED, "stopped", released=False)
    failed = task.after_homing(ErrorCode.NO_PATH, "no way", released=False)
    assert (stopped.next, stopped.code) == (Next.END, ErrorCode.TASK_STOPPED)
    assert (failed.next, failed.code) == (Next.END, ErrorCode.TASK_ARM_FAILED)


def test_a_hand_fault_after_the_release_is_a_success_with_a_code(task: ClearTable):
    step = task.after_prediction(OK, "", grasps((0.3, 0.0)))
    task.after_execution(ErrorCode.HAND_BLOCKED, "jammed", step.indices[0], placed=True)
    assert task.records[0].success and task.records[0].code == ErrorCode.HAND_BLOCKED
    assert task.places == []


def test_no_way_home_after_a_grasp_is_a_fault_of_the_arm_and_the_table_is_looked_at_again():
    task = ClearTable(Settings(max_attempts=2), seed=0)
    candidates = grasps((0.3, 0.0), (0.3, 0.2))
    task.after_prediction(OK, "", candidates)
    after = task.after_execution(ErrorCode.NO_PATH, "no way home", 0)
    assert (after.next, task.attempts) == (Next.CAPTURE, 1), "the scene has changed: no old candidates"
    task.after_prediction(OK, "", candidates)
    end = task.after_execution(ErrorCode.NO_PATH, "no way home", 0)
    assert (end.next, end.code) == (Next.END, ErrorCode.TASK_ATTEMPTS_USED_UP)


def test_what_is_offered_next_is_known_while_an_attempt_is_under_way():
    task = ClearTable(Settings(max_attempts=2), 0)
    first = task.after_prediction(OK, "", grasps((0.3, 0.0)))
    following = grasps((0.4, 0.1), (0.5, 0.2))
    foreseen = task.if_it_succeeds(first.indices[0])
    assert foreseen.after_prediction(OK, "", following).indices == (0, 1)
    assert foreseen.on_the_last_attempt and not task.on_the_last_attempt
    assert task.attempts == 0 and task.after_prediction(OK, "", grasps((0.3, 0.0))).indices == (0,)


def test_what_failed_on_a_thing_is_foreseen_where_a_push_will_have_taken_it():
    task = ClearTable(Settings(failures_per_place=1), 0)
    attempt(task, (0.3, 0.0))
    step = task.after_prediction(OK, "", joined([push(0.4, 0.1), grasps((0.6, 0.0))]))
    foreseen = task.if_it_succeeds(step.indices[0])
    assert (foreseen.pushes, foreseen.attempts, task.pushes) == (1, 1, 0)
    np.testing.assert_allclose(foreseen.failed.poses[0, 0, 3], 0.3)  # 10 cm away: of something else
    task = ClearTable(Settings(failures_per_place=3), 0)
    attempt(task, (0.35, 0.0))
    step = task.after_prediction(OK, "", push(0.4, 0.1))
    np.testing.assert_allclose(task.if_it_succeeds(step.indices[0]).failed.poses[0, 0, 3], 0.45)


def test_a_scene_that_changed_before_anything_moved_is_looked_at_again_and_is_no_attempt(task: ClearTable):
    task.after_prediction(OK, "", grasps((0.3, 0.0)))
    step = task.after_execution(ErrorCode.SCENE_CHANGED, "changed", -1)
    assert step.next is Next.CAPTURE and task.attempts == 0 and task.places == []

"""The robot protocol: which scenes, what counts as whose failure, the page and the README; the runs are made up."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.planner import SHIPPED
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Experiment, Row
from dgs_learning.evaluation.records import claim
from dgs_learning.evaluation.report.page import write_report
from dgs_learning.evaluation.report.tables import experiment_result, experiment_table
from dgs_learning.evaluation.report.templates import render
from dgs_learning.evaluation.robot import (
    carried_through,
    check_robot_row,
    finish_robot,
    scene_folder,
    scene_request,
)
from dgs_learning.evaluation.robot_metrics import failure_kind, refused_grasps, summarise_robot
from tests.dgs_learning.evaluation.report.test_page import SETTING, Page

ROBOT = Row("robot", scenes=2, seed=3, arm=True)


def attempt(success: bool, code: int, source: str = "dgs_net") -> dict:
    return {
        "success": success, "code": code, "message": "", "score": 0.9, "seconds": {"lift": 4.0} if success else {},
        "source": source,
    }  # fmt: skip


def scene(seed: int, objects: int, cleared: int, records: list[dict], refusals: tuple[str, ...] = ()) -> dict:
    return {
        "seed": seed,
        "objects": objects,
        "cleared": cleared,
        "attempts": len(records),
        "successes": sum(r["success"] for r in records),
        "records": records,
        "refusals": list(refusals),
        "seconds": {"total": 20.0 * len(records)},
        "simulated_seconds": 60.0 * len(records),
        "error_code": 0,
        "message": "the table is empty",
        "revision": "abc",
        "model": "dgs_net 123",
    }


SCENES = [
    scene(3000, 4, 4, [attempt(True, 0)] * 3 + [attempt(True, ErrorCode.HAND_BLOCKED)]),
    scene(
        3001,
        6,
        1,
        [
            attempt(True, 0),
            attempt(True, ErrorCode.LOST_OBJECT, source="level_pinch"),
            attempt(False, ErrorCode.NOTHING_HELD, source="level_pinch"),
            attempt(False, ErrorCode.LOST_OBJECT),
            attempt(False, ErrorCode.TRAJECTORY_ABORTED),
            attempt(False, ErrorCode.HAND_BLOCKED),
            attempt(False, ErrorCode.EXECUTION_CANCELLED),
        ],
        ("none of 9 grasps can be executed: 6 OUT_OF_REACH, 3 NO_PATH", "none of 1 grasps: 1 NO_PATH"),
    ),
]


def test_rates_count_the_arms_failures_apart() -> None:
    s = summarise_robot(SCENES)
    assert (s["attempts"], s["successes"]) == (10, 6)  # the one that the time limit cut off does not count
    assert s["sr"] == pytest.approx(0.6)
    assert s["sr_grasp"] == pytest.approx(6 / 8)
    assert s["cr_pooled"] == pytest.approx(0.5)
    assert s["cr_scene_mean"] == pytest.approx((1 + 1 / 6) / 2)
    assert s["failures"] == {
        "not lifted": 1, "lost in lift": 1, "planning failure": 0, "execution abort": 1, "hand fault": 1,
        "no reachable grasp": 2,
    }  # fmt: skip
    assert s["level_pinches"] == {"attempts": 2, "successes": 1}
    assert s["after_lift"] == {"lost on the way": 1, "taken for lost": 1, "fault on the way": 1}
    assert s["refused_grasps"] == {"OUT_OF_REACH": 6, "NO_PATH": 4}
    assert (s["time_s"]["wall"], s["time_s"]["simulated"]) == (pytest.approx(22.0), pytest.approx(66.0))
    assert s["picks_per_hour"] == pytest.approx(3600 * s["cleared"] / (10 * 66.0)), (
        "failed tries are no picks"
    )
    assert s["time_s"]["stages"] == {"lift": pytest.approx(2.4)}


def test_a_scene_without_attempts_and_one_in_which_more_came_into_the_bin_than_was_lifted() -> None:
    nothing = summarise_robot([scene(3000, 4, 0, [])])
    assert (nothing["sr"], nothing["picks_per_hour"], nothing["time_s"]["simulated"]) == (0.0, 0.0, 0.0)
    swept = summarise_robot([scene(3000, 2, 2, [attempt(True, 0)]), scene(3001, 2, 0, [attempt(True, 0)])])
    assert swept["after_lift"]["lost on the way"] == 1


def test_the_most_that_was_pressed_on_the_table_is_told_by_stage() -> None:
    pressed = [{"approach": 3.0, "lift": 8.0}, {"approach": 5.0, "lift": 2.0}]
    scenes = [{**SCENES[0], "table_force": forces} for forces in pressed]
    assert summarise_robot([*scenes, SCENES[1]])["table_force"] == {"approach": 5.0, "lift": 8.0}


def test_every_code_of_arm_and_hand_has_a_kind() -> None:
    kinds = {code.name: failure_kind(code) for code in ErrorCode if 200 <= code < 400}
    planning = {kinds[name] for name in ("NO_CANDIDATES", "COLLISION_LIFT", "NO_FEASIBLE_GRASP")}
    assert planning == {"planning failure"}
    assert kinds["PROTECTIVE_STOP"] == "execution abort"
    assert kinds["HAND_UNAVAILABLE"] == kinds["HAND_TIMEOUT"] == "hand fault"
    assert [name for name, kind in kinds.items() if kind in ("not lifted", "lost in lift")] == [
        "NOTHING_HELD", "LOST_OBJECT", "FORCE_LIMIT",
    ]  # fmt: skip


def test_words_that_are_no_codes_are_not_counted() -> None:
    assert refused_grasps(["none of 12 grasps: 7 IK_FAILED, 5 UFO"]) == {"IK_FAILED": 7}


def test_scenes_depend_on_seed_and_number_alone() -> None:
    wanted = [scene_request(ROBOT, n) for n in range(40)]
    assert wanted == [scene_request(ROBOT, n) for n in range(40)]
    assert [seed for seed, _ in wanted] == list(range(3000, 3040))
    assert {count for _, count in wanted} == {4, 5, 6}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"proposers": ("top_down",)}, "the planner is the node's"),
        ({"ablate": "offset"}, "no ablation"),
        ({"workspace": (0.6, 0.6)}, "0.4 x 0.8 m"),
        ({"condition": Condition(noise=2)}, "camera and workspace are the cell's"),
        ({"condition": Condition(worn=True)}, "with --arm hardware, camera"),
        ({"scenes": 1001}, "at most 1000"),
    ],
)
def test_what_the_robot_cannot_do_is_refused(changes: dict, said: str) -> None:
    check_robot_row(ROBOT)
    with pytest.raises(ValueError, match=said):
        check_robot_row(replace(ROBOT, **changes))


@pytest.mark.parametrize(
    ("code", "counts"),
    [
        (ErrorCode.SUCCESS, True),
        (ErrorCode.TASK_CANCELLED, True),  # the time was up
        (ErrorCode.TASK_ARM_FAILED, True),
        (ErrorCode.TASK_NO_CLOUD, False),
        (ErrorCode.TASK_PLANNER_FAILED, False),
    ],
)
def test_a_silent_camera_or_planner_is_no_result(code: ErrorCode, counts: bool, tmp_path: Path) -> None:
    assert not carried_through(tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps({**SCENES[0], "error_code": int(code)}))
    assert carried_through(tmp_path) is counts


@pytest.fixture
def robot_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "robot"
    robot = {"protocol": "robot", "proposers": list(SHIPPED), "scenes": 2, "seed": 3, "speed_up": 2.0}
    described = SETTING | robot
    claim(folder, described)
    for number, summary in enumerate(SCENES):
        target = scene_folder(folder, number)
        target.mkdir(parents=True)
        (target / "summary.json").write_text(json.dumps(summary))
        Image.new("RGB", (64, 36), "white").save(target / "grasps_camera.png")
    (folder / "scenes" / "scene_0001.broken1").mkdir()
    finish_robot(folder, described, 2)
    return folder


def test_the_page_shows_table_5_and_the_worst_scene_first(robot_folder: Path, tmp_path: Path) -> None:
    text = write_report([robot_folder], tmp_path / "r.html").read_text()
    page = Page(text)
    assert page.stack == []
    assert all(s.startswith("data:image/jpeg;base64,") for s in page.sources)
    assert len(page.sources) == 2
    words = " ".join(" ".join(page.words).split())
    for expected in (
        "78.98",
        "86.86",
        "1 of 6 cleared",
        "out of reach 6",
        "simulated robot, 2 scenes of 4-6 objects",
    ):
        assert expected in words
    assert words.index("1 of 6 cleared") < words.index("4 of 4 cleared")
    assert "Success by shape class" not in words


def test_the_table_has_the_robot_beside_table_5(robot_folder: Path) -> None:
    summary = json.loads((robot_folder / "summary.json").read_text())
    table = experiment_table(
        experiment_result(Experiment("paper", "", (ROBOT,), ("table_3", "table_5")), [summary])
    )
    row = next(line for line in table.splitlines() if line.startswith("| planner (DGS-Net"))
    assert "simulated robot, 2 scenes of 4-6 objects (novel) in 0.4 x 0.8 m, 10 attempts" in row
    assert "60.0 (" in row
    assert "75.0" in row
    assert "hand fault 1" in row
    assert "| *paper: DGS-Net* | real robot, 25 scenes" in table
    assert "YCB" not in table  # the free hand's rows of the paper stand below a free hand's


def test_the_text_for_the_terminal_names_failures_and_suite_failures(robot_folder: Path) -> None:
    summary = json.loads((robot_folder / "summary.json").read_text())
    assert summary["suite_failures"] == 1
    text = render("robot.txt", s=summary)
    assert "hand fault 1" in text and "the suite itself: 1" in text
    assert "OUT_OF_REACH 6, NO_PATH 4" in text

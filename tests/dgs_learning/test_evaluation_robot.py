"""The robot protocol: which scenes, what counts as whose failure, the page and the README; the runs are made up."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image
from typer.testing import CliRunner

from dgs_description.errors import ErrorCode
from dgs_learning.cli.app import app
from dgs_learning.evaluation.proposers import PlannerChoice
from dgs_learning.evaluation.protocol import Setting
from dgs_learning.evaluation.readme import fill_readme, publish
from dgs_learning.evaluation.records import claim
from dgs_learning.evaluation.report import write_report
from dgs_learning.evaluation.robot import (
    carried_through,
    check_robot_setting,
    robot_table,
    scene_folder,
    scene_request,
    write_robot_summary,
)
from dgs_learning.evaluation.robot_metrics import failure_kind, refused_grasps, summarise_robot
from tests.dgs_learning.test_evaluation_report import Page

ROBOT = Setting(scenes=2, objects_per_scene=(4, 6), area=(0.4, 0.8), seed=3)


def attempt(success: bool, code: int, proposed: bool = False) -> dict:
    return {
        "success": success, "code": code, "message": "", "score": 0.9, "seconds": {"lift": 4.0}, "proposed": proposed,
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
        2,
        [
            attempt(True, 0),
            attempt(True, ErrorCode.LOST_OBJECT, proposed=True),
            attempt(False, ErrorCode.NOTHING_HELD, proposed=True),
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
    assert s["cr_pooled"] == pytest.approx(0.6)
    assert s["cr_scene_mean"] == pytest.approx((1 + 1 / 3) / 2)
    assert s["failures"] == {
        "not lifted": 1, "lost in lift": 1, "planning failure": 0, "execution abort": 1, "hand fault": 1,
        "no reachable grasp": 2,
    }  # fmt: skip
    assert s["level_pinches"] == {"attempts": 2, "successes": 1}
    assert s["after_lift"] == {"lost on the way": 1, "fault on the way": 1}
    assert s["refused_grasps"] == {"OUT_OF_REACH": 6, "NO_PATH": 4}
    assert s["time_s"]["simulated"] == pytest.approx(66.0)
    assert s["time_s"]["stages"] == {"lift": pytest.approx(4.0)}


def test_every_code_of_arm_and_hand_has_a_kind() -> None:
    kinds = {code.name: failure_kind(code) for code in ErrorCode if 200 <= code < 400}
    assert kinds["COLLISION_LIFT"] == "planning failure"
    assert kinds["PROTECTIVE_STOP"] == "execution abort"
    assert kinds["HAND_UNAVAILABLE"] == kinds["HAND_TIMEOUT"] == "hand fault"
    assert [name for name, kind in kinds.items() if kind in ("not lifted", "lost in lift")] == [
        "NOTHING_HELD", "LOST_OBJECT",
    ]  # fmt: skip


def test_words_that_are_no_codes_are_not_counted() -> None:
    assert refused_grasps(["none of 12 grasps: 7 IK_FAILED, 5 UFO"]) == {"IK_FAILED": 7}


def test_no_scene_is_no_division_by_zero() -> None:
    assert summarise_robot([])["sr"] == 0.0


def test_scenes_depend_on_seed_and_number_alone() -> None:
    wanted = [scene_request(ROBOT, n) for n in range(40)]
    assert wanted == [scene_request(ROBOT, n) for n in range(40)]
    assert [seed for seed, _ in wanted] == list(range(3000, 3040))
    assert {count for _, count in wanted} == {4, 5, 6}


@pytest.mark.parametrize(
    ("choice", "changes", "said"),
    [
        (PlannerChoice("top_down"), {}, "the planner is the node's"),
        (PlannerChoice(), {"ablate": "offset"}, "without ablation"),
        (PlannerChoice(), {"area": (0.6, 0.6)}, "0.4 x 0.8 m, not 0.6 x 0.6 m"),
        (PlannerChoice(), {"scenes": 1001}, "at most 1000"),
    ],
)
def test_what_the_robot_cannot_do_is_refused(choice: PlannerChoice, changes: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        check_robot_setting(choice, Setting(**{**vars(ROBOT), **changes}))
    check_robot_setting(PlannerChoice(), ROBOT)


def test_the_command_refuses_before_anything_is_started(tmp_path: Path) -> None:
    words = ["evaluate", "--arm", "--workspace", "0.6", "0.6", "--out", str(tmp_path / "run")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "robot's workspace" in " ".join(result.output.replace("│", " ").split())
    assert not (tmp_path / "run").exists()


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
    described = {
        "protocol": "robot",
        "planner": "dgs_net",
        "model": "dgs_net",
        "model_sha256": "aa",
        "objects": {"name": "novel", "objects": 70, "sha256": "ff"},
        "scenes": 2,
        "objects_per_scene": [4, 6],
        "area": [0.4, 0.8],
        "seed": 3,
        "ablate": "none",
        "speed_up": 2.0,
    }
    claim(folder, described)
    for number, summary in enumerate(SCENES):
        target = scene_folder(folder, number)
        target.mkdir(parents=True)
        (target / "summary.json").write_text(json.dumps(summary))
        Image.new("RGB", (64, 36), "white").save(target / "grasps_camera.png")
    (folder / "scenes" / "scene_0001.broken1").mkdir()
    write_robot_summary(folder, described, 2)
    return folder


def test_a_free_hands_folder_is_not_the_robots(robot_folder: Path) -> None:
    described = json.loads((robot_folder / "setting.json").read_text())
    claim(robot_folder, {**described, "scenes": 5})
    for key in ("protocol", "speed_up"):
        other = {k: v for k, v in described.items() if k != key}
        with pytest.raises(ValueError, match=key):
            claim(robot_folder, other)


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
        "2 of 6 cleared",
        "out of reach 6",
        "simulated robot, 2 scenes of 4-6 objects",
    ):
        assert expected in words
    assert words.index("2 of 6 cleared") < words.index("4 of 4 cleared")
    assert "Success by shape class" not in words


def test_the_readme_shows_the_robot_beside_table_5(robot_folder: Path, tmp_path: Path) -> None:
    results = tmp_path / "results"
    (published,) = publish([robot_folder], results)
    assert published.name == "robot_4-6_seed3.json"
    (results / "speed.json").write_text(json.dumps({"setting": {"threads": 1}}))  # not an evaluation
    readme = tmp_path / "README.md"
    readme.write_text("<!-- results:start -->\n<!-- results:end -->\n")
    assert fill_readme(readme, results)
    row = next(line for line in readme.read_text().splitlines() if line.startswith("| DGS-Net"))
    assert "60.0 (" in row
    assert "75.0" in row
    assert "| *paper: DGS-Net* | real robot, 25 scenes" in readme.read_text()


def test_the_table_of_the_terminal_names_failures_and_suite_failures(robot_folder: Path) -> None:
    summary = json.loads((robot_folder / "summary.json").read_text())
    assert summary["suite_failures"] == 1
    assert "hand fault 1" in robot_table(summary)
    assert "6 OUT_OF_REACH, 4 NO_PATH" in robot_table(summary)

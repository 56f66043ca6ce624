"""The harness: the same table for the same seed on any number of workers, resuming, the floor on SR."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.planner import SHIPPED, STAGES
from dgs_grasp_planner.scene import Prediction
from dgs_learning.evaluation import run
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.records import failure_file, load_scene
from dgs_learning.evaluation.report.page import load_run
from dgs_learning.evaluation.run import run_row
from tests.dgs_learning.evaluation.test_protocol import in_the_air

SMALL = Row(
    "small", proposers=("top_down",), scenes=2, objects_per_scene=(2, 3), workspace=(0.4, 0.4), seed=4
)


@pytest.fixture(scope="module")
def small_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small")
    run_row(SMALL, folder)
    return folder


def outcomes(folder: Path, scenes: int = SMALL.scenes) -> list[dict]:
    """Everything of a run but its times."""
    rows = []
    for number in range(scenes):
        scene, _ = load_scene(folder, number)
        attempts = [replace(a, seconds=0.0, cpu_seconds=0.0, stage_times={}) for a in scene.attempts]
        rows.append(vars(replace(scene, attempts=tuple(attempts))))
    return rows


def test_every_failed_attempt_is_drawn_from_the_trial_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A planner that grasps at thin air twice, then answers nothing: two failures, two pictures."""
    air = in_the_air("air", active_fingers=True)
    answers = iter([air, air, GraspSet.empty(), GraspSet.empty()])
    planner = lambda cloud, camera, rng, request: Prediction(next(answers), len(cloud), {})  # noqa: E731
    monkeypatch.setattr(run, "planner_of", lambda choice, truth: planner)
    stale, others = failure_file(tmp_path, 0, 2), failure_file(tmp_path, 10, 0)
    stale.parent.mkdir()
    for file in (
        stale,
        others,
    ):  # the first one of a start that was killed, by a program that did worse there
        file.write_bytes(b"")
    summary = run_row(replace(SMALL, scenes=1, objects_per_scene=(1, 1)), tmp_path)
    (lost,) = summary["losses"]
    assert lost["ends"] == {"missed": 2}
    drawn = sorted((tmp_path / "failures").iterdir())
    assert drawn == [failure_file(tmp_path, 0, 0), failure_file(tmp_path, 0, 1), others]
    assert all(file.stat().st_size < 60_000 for file in drawn)
    (row,) = load_run(tmp_path).losses()
    assert row[0]["object"] == lost["object"] and len(row[1]) == 2


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_top_down_reaches_its_floor(small_run: Path) -> None:
    summary = json.loads((small_run / "summary.json").read_text())
    assert summary["attempts"] >= 4
    assert summary["sr"] >= 0.6, summary["failures"]
    assert set(summary) >= {
        "proposers", "stages", "sr", "sr_interval", "cr_pooled", "cr_scene_mean", "pd_mm", "pv_mm3", "diversity",
        "time_s", "per_class", "failures", "setting",
    }  # fmt: skip
    assert summary["setting"]["seed"] == 4
    assert summary["setting"]["revision"]
    lines = (small_run / "attempts.csv").read_text().splitlines()
    assert len(lines) == 1 + summary["attempts"] + summary["failures"]["no grasp found"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_workers_give_the_same_table_and_a_stopped_run_goes_on(small_run: Path, tmp_path: Path) -> None:
    run_row(replace(SMALL, scenes=1), tmp_path)
    first = (tmp_path / "scenes" / "scene_0000.json").read_text()
    run_row(SMALL, tmp_path, workers=2)
    assert (tmp_path / "scenes" / "scene_0000.json").read_text() == first  # was not made again
    assert outcomes(tmp_path) == outcomes(small_run)
    for other in ({"seed": 5}, {"condition": Condition(noise=2)}, {"without": ("rank",)}):
        with pytest.raises(ValueError, match="another setting"):
            run_row(replace(SMALL, **other), tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_harness_lifts_validated_grasps(tmp_path: Path) -> None:
    """Grasps of the dataset on the true poses: what fails here is the harness's fault, not a planner's."""
    summary = run_row(replace(SMALL, proposers=("replay",), without=STAGES, objects="dataset"), tmp_path)
    assert summary["attempts"] >= 4
    assert summary["sr"] >= 0.8, summary["failures"]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_shipped_planner_reaches_its_floor(tmp_path: Path) -> None:
    summary = run_row(replace(SMALL, proposers=SHIPPED), tmp_path)
    assert summary["sr"] >= 0.6, summary["failures"]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_condition_is_a_setting_of_its_own(small_run: Path, tmp_path: Path) -> None:
    row = replace(SMALL, scenes=1, condition=Condition(noise=0, spoil="no_table", table_error=0.005))
    summary = run_row(row, tmp_path)
    assert summary["setting"]["condition"]["spoil"] == "no_table"
    assert outcomes(tmp_path, 1) != outcomes(small_run, 1)

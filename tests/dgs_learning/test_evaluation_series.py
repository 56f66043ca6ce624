"""Loss chain and robustness: what is put in for the network's answers, what is done to clouds, tables that go on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dgs_description.documents import fill_block
from dgs_description.errors import DgsError
from dgs_description.grasp import GraspSet, Prediction
from dgs_grasp_planner.network import save_network
from dgs_grasp_planner.network.weights import file_sha256
from dgs_grasp_planner.planner import PlannerConfig
from dgs_learning.cli.app import app
from dgs_learning.evaluation.growth import seen
from dgs_learning.evaluation.loss_chain import CHAIN, STAGES, without
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.proposers import PlannerChoice
from dgs_learning.evaluation.proposers.replay import StoredGrasps
from dgs_learning.evaluation.protocol import Setting, Truth
from dgs_learning.evaluation.provenance import describe_planner
from dgs_learning.evaluation.records import scene_file
from dgs_learning.evaluation.robustness import (
    CONDITIONS,
    MISSING,
    Condition,
    Disturbed,
    run_condition,
    scaled_noise,
    with_background,
    with_holes,
    without_plane,
)
from dgs_learning.evaluation.series import Row, series_note, series_table, write_series
from dgs_learning.training.views import View, ViewSettings, capture
from tests.dgs_grasp_planner.models import eager_network
from tests.dgs_learning.tiny_dataset import tiny_dataset

DATA = tiny_dataset()
POSES = list(DATA.scenes[0].T_table_object)
TRUTH = Truth(lambda: (DATA.objects, POSES))
ALL_OFF = without(PlannerConfig(), STAGES)


@pytest.fixture(scope="module")
def view() -> View:
    return capture(
        DATA.objects, POSES, np.random.default_rng(1), replace(ViewSettings(), elevation=(0.9, 1.0))
    )


@pytest.fixture(scope="module")
def stored() -> StoredGrasps:
    return StoredGrasps(DATA)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_stages_can_be_left_out_one_by_one() -> None:
    full = PlannerConfig()
    assert without(full, ()) == full
    assert without(full, ("move",)).refine == replace(full.refine, move=False)
    assert without(full, ("propose",)).refine.level_pinch.proposals == 0
    assert not any((ALL_OFF.refine.move, ALL_OFF.refine.close, ALL_OFF.refine.rank))
    assert ALL_OFF.checks != full.checks
    with pytest.raises(ValueError, match="checks, move, close, rank, propose"):
        without(full, ("luck",))
    names = [describe_planner(PlannerChoice(step.planner, without=step.without)) for step in CHAIN]
    assert len({json.dumps(name) for name in names}) == len(CHAIN), "every step has a folder of its own"


def test_holes_are_holes(view: View) -> None:
    left = with_holes(view.points, view.camera, rng())
    assert 1 - MISSING - 0.15 < len(left) / len(view.points) <= 1 - MISSING
    np.testing.assert_array_equal(left, with_holes(view.points, view.camera, rng()))


def test_plane_and_background(view: View) -> None:
    assert without_plane(view.points, view.camera, rng())[:, 2].min() > 0.005
    more = with_background(view.points, view.camera, rng())
    wall = more[len(view.points) :]
    away = -view.camera[:2] / np.linalg.norm(view.camera[:2])
    assert len(wall) > 1000 and wall[:, 2].max() > 0.15
    assert (wall[:, :2] @ away).min() > np.percentile(view.points[:, :2] @ away, 90)


def test_noise_is_scaled_and_switched_off() -> None:
    depth = np.full((480, 848), 1.0, dtype=np.float32)
    from dgs_sim_bridge.render.d455 import D455

    spread = []
    for factor in (0.0, 1.0, 2.0):
        image = scaled_noise(factor).apply(depth, D455, rng())
        spread.append(float(image[image > 0].std()))
    assert spread[0] < 1e-3 < spread[1] < spread[2]


def test_a_wrong_table_height_shifts_what_the_planner_sees_and_not_its_grasps(view: View) -> None:
    """A planner that grasps at the highest point it sees must end at the true one."""
    heard: list[float] = []

    def highest(cloud: np.ndarray, camera: np.ndarray, generator: np.random.Generator) -> Prediction:
        top = cloud[cloud[:, 2].argmax()].astype(float)
        heard.append(float(top[2]))
        joints = np.zeros((1, 20))
        one = GraspSet(top[None], np.eye(3)[None], joints, joints, np.ones(1), top[None], np.zeros((1, 3)))
        return Prediction(one, len(cloud), {})

    condition = Condition("table_low", "", table_error=0.005)
    answer = Disturbed(highest, condition)(view.points, view.camera, rng())
    true = float(view.points[:, 2].max())
    assert heard[0] == pytest.approx(true + 0.005, abs=1e-6)
    assert answer.grasps.position[0, 2] == pytest.approx(true, abs=1e-6)
    assert answer.grasps.reference_point[0, 2] == pytest.approx(true, abs=1e-6)


def test_conditions_are_told_apart() -> None:
    described = [json.dumps(condition.described()) for condition in CONDITIONS]
    assert len(set(described)) == len(CONDITIONS)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_condition_is_finished_where_it_stopped(tmp_path: Path) -> None:
    setting = Setting(1, (1, 1), (0.4, 0.4), 3)
    choice, condition = PlannerChoice("top_down"), CONDITIONS[0]
    summary = run_condition(condition, DATA.objects, "tiny", choice, setting, tmp_path)
    assert summary["scenes"] == 1 and summary["setting"]["condition"] == "reference"
    first = scene_file(tmp_path, 0).read_text()
    again = run_condition(condition, DATA.objects, "tiny", choice, replace(setting, scenes=2), tmp_path)
    assert again["scenes"] == 2 and scene_file(tmp_path, 0).read_text() == first
    with pytest.raises(ValueError, match="another setting"):
        run_condition(CONDITIONS[1], DATA.objects, "tiny", choice, setting, tmp_path)


def test_what_weights_have_seen_is_read_from_their_notes(tmp_path: Path) -> None:
    data = tmp_path / "data.npz"
    data.write_bytes(b"the present data")
    notes = {
        "step": 30,
        "training": {"batch": 4, "training_scenes": 48},
        "dataset": {"sha256": file_sha256(data)},
    }
    first = save_network(eager_network(), tmp_path, "first", notes)
    start = {"model_id": "first", "sha256": first.sha256, "step": 30}
    save_network(
        eager_network(1),
        tmp_path,
        "second",
        {**notes, "step": 10, "init": start, "dataset": {"sha256": "older"}},
    )
    one = seen(tmp_path / "first.pt", data)
    assert (one.views, one.scenes, one.text) == (120, 48, "120 views of 48 scenes")
    two = seen(tmp_path / "second", data, [tmp_path / "first.pt"])
    assert (two.folder, two.model) == (tmp_path, "second")
    assert two.text == "160 views of 48 scenes of an earlier dataset"
    with pytest.raises(DgsError, match="began from first"):
        seen(tmp_path / "second", data)
    save_network(eager_network(), tmp_path, "untold")
    with pytest.raises(DgsError, match="untold has no notes"):
        seen(tmp_path / "untold", data)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_growth_has_a_row_for_every_file_of_weights_alone_and_in_the_planner(tmp_path: Path) -> None:
    data = tmp_path / "data.npz"
    data.write_bytes(b"no dataset is read")
    for name, step in (("late", 9), ("early", 3)):
        save_network(eager_network(), tmp_path, name, {"step": step, "training": {"batch": 2}})
    asked = [
        "growth", str(tmp_path / "late.pt"), str(tmp_path / "early"), "--scenes", "1", "--objects-per-scene", "1",
        "--dataset", str(data), "--out", str(tmp_path / "runs"), "--workers", "1",
    ]  # fmt: skip
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 0, result.output
    table = [
        line.split("|")[1].strip()
        for line in result.output.splitlines()
        if line.startswith("| ") and "views" in line
    ]
    views = ["6 views of an earlier dataset", "18 views of an earlier dataset"]
    assert table == [f"{v}, {where}" for where in ("alone", "in the planner") for v in views]


def test_table_json_and_block(tmp_path: Path) -> None:
    setting = {
        "scenes": 2, "objects_per_scene": [4, 6], "objects": {"name": "novel"}, "seed": 1, "revision": "abc",
        "date": "2026-01-01", "model_sha256": "feed",
    }  # fmt: skip
    rows = [Row(name, f"text of {name}", {**summarise([]), "setting": setting}) for name in ("one", "two")]
    text = series_table(rows)
    assert text.count("\n") == 3 and "text of two" in text
    assert "2 scenes of 4 to 6 objects (novel)" in series_note(rows) and "`feed`" in series_note(rows)
    write_series(tmp_path / "results" / "chain.json", rows)
    kept = json.loads((tmp_path / "results" / "chain.json").read_text())
    assert [row["name"] for row in kept["rows"]] == ["one", "two"] and kept["rows"][0]["sr_interval"] == [
        0.0,
        1.0,
    ]
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- chain:start -->\nold\n<!-- chain:end -->\nafter\n")
    fill_block(page, "chain", text)
    fill_block(page, "chain", text)
    assert page.read_text().startswith("before\n") and page.read_text().endswith("-->\nafter\n")
    assert page.read_text().count("text of one") == 1 and "old" not in page.read_text()
    with pytest.raises(ValueError, match="other:start"):
        fill_block(page, "other", text)


@pytest.mark.parametrize("command", ["loss-chain", "robustness", "growth models/dgs_net"])
def test_an_unknown_run_is_refused_with_the_names_there_are(command: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [*command.split(), "--out", str(tmp_path), "--only", "luck"])
    assert result.exit_code == 2
    assert "no run named 'luck'" in " ".join(result.output.replace("│", " ").split())

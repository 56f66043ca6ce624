"""`dgs publish` and `dgs plot-curve`: every number of the card is one of its files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import torch
from typer.testing import Result

from dgs_description import hand
from dgs_grasp_planner.network import PRESETS, DGSNet, load_network, save_network
from dgs_learning.cli.files import write_json
from dgs_learning.dataset import save_dataset
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.report.templates import read_data
from dgs_learning.training.curve import HELD_OUT, TRAIN, CurveLog
from tests.dgs_grasp_planner.models import eager_network
from tests.dgs_learning.evaluation.report.test_tables import result_of
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.commands import dgs

TRAINING = {"steps": 500, "batch": 4, "device": "cpu", "views_per_scene": 16, "held_out_scenes": 4}
TERMS = ("loss", "precision", "recall", "angle_deg", "offset_mm", "j_end_rad")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Weights and dataset, nothing measured yet."""
    save_dataset(tmp_path / "dataset.npz", tiny_dataset())
    save_network(eager_network(), tmp_path / "models", "tiny", {"step": 321, "training": TRAINING})
    return tmp_path


def _card(tree: Path, *more: str, code: int = 0) -> Result:
    words = ["publish", "--name", "tiny", "--models-dir", str(tree / "models")]
    words += ["--dataset", str(tree / "dataset.npz"), "--results", str(tree / "results"), *more]
    return dgs(words, code)


def _curve(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    log = CurveLog(folder / "curve.csv")
    for step in (10, 20, 30):
        log.append(step, TRAIN, {"samples_per_s": 2.0, **{name: 8.0 / step for name in TERMS}})
    log.append(20, HELD_OUT, {name: 0.77 for name in TERMS})
    return folder


def _measure(tree: Path, sha256: str) -> None:
    speed = tree / "results" / "speed"
    speed.mkdir(parents=True)
    machine = {"gpu": None, "processor": "Slow CPU", "cores": 2, "load_average": 0.1}
    values = {
        "total_s": 0.1234, "total_p90_s": 0.2345, "network_s": 0.0456, "network_p90_s": 0.0567, "threads": 2,
        "stages": {"network": 0.0404, "refine": 0.0052}, "points_in": 171717, "points_used": 20000, "voxels": 6101,
        "precision": "bfloat16", "machine": machine, "model": {"sha256": sha256},
    }  # fmt: skip
    (speed / "cpu.json").write_text(json.dumps(values))
    rows = [Row("mine"), Row("older", text="earlier weights")]
    result = result_of(*rows, paper=("table_2",))
    result["rows"][0] |= {"sr": 0.654, "sr_interval": [0.55, 0.74]}
    result["rows"][0]["setting"]["model_sha256"] = sha256[:16]
    write_json(tree / "results" / "stages.json", result)
    write_json(tree / "results" / "growth.json", result_of(Row("not beside the paper")))


def test_card_of_a_measured_model(tree: Path) -> None:
    save_network(eager_network(1), _curve(tree / "run"), "latest", {"step": 321, "training": TRAINING})
    first = _card(tree, str(tree / "run"))
    assert "tiny: step 321" in first.output
    sidecar = json.loads((tree / "models" / "tiny.json").read_text())
    _measure(tree, sidecar["sha256"])
    _card(tree)
    text = (tree / "models" / "README.md").read_text()
    assert sidecar["sha256"] in text and "321 of 500 steps of 4 views (1284 views)" in text
    assert "2 objects (scales counted apart), 4 validated grasps" in text
    assert "3 scenes of 2.0 objects with 12 feasible grasps" in text
    assert "| cuboid | 1 | 2 |" in text and "| bowl | 0 | 0 |" in text
    assert "| train | 30 | 0.267 |" in text and "| held-out | 20 | 0.77 |" in text
    assert (
        "### stages" in text
        and "65.4 (55.0–74.0)" in text
        and "Not measured with these weights: the rows older." in text
    )
    assert "not beside the paper" not in text
    for deviation in read_data("deviations"):
        assert f"| {deviation['what']} | {deviation['paper']} |" in text
    assert "| Slow CPU | bfloat16 | 2 | 6101 | 123.4 (234.5) | 45.6 (56.7) | these |" in text
    assert "busy" not in text and "Not measured yet" not in text
    picture = tree / "models" / "tiny_curve.png"
    assert "![Curves of the training](tiny_curve.png)" in text
    assert cv2.imread(str(picture)).shape[1] > 500 and picture.stat().st_size < 120_000
    assert (tree / "models" / "tiny_curve.csv").read_text() == (tree / "run" / "curve.csv").read_text()
    assert "{{" not in text and "{%" not in text
    (tree / "run" / "curve.csv").unlink()
    _card(tree, str(tree / "run"))
    assert "No curve of this training" in (tree / "models" / "README.md").read_text(), "of others is none"
    assert not list((tree / "models").glob("tiny_curve.*"))


def test_a_share_of_the_weights_that_are_there_may_be_kept(tree: Path) -> None:
    save_network(eager_network(1), tree / "run", "latest", {"step": 9, "training": TRAINING})
    new, old = eager_network(1).state_dict(), load_network(tree / "models", "tiny")[0].state_dict()
    _card(tree, str(tree / "run"), "--keep", "0.25")
    mean, info = load_network(tree / "models", "tiny")
    for key, value in mean.state_dict().items():
        torch.testing.assert_close(value, 0.75 * new[key] + 0.25 * old[key], atol=2e-3, rtol=2e-3)
    assert info.notes["kept"]["step"] == 321 and info.notes["step"] == 9
    assert "| averaged with | 25.0 %" in (tree / "models" / "README.md").read_text()
    again = _card(tree, str(tree / "run"), "--keep", "0.25", code=2)
    assert "a mean with these weights already" in again.output
    assert load_network(tree / "models", "tiny")[1].sha256 == info.sha256
    other = DGSNet(replace(PRESETS["tiny"], voxel_size=0.01))
    save_network(other, tree / "run", "latest", {"step": 9, "training": TRAINING})
    assert "different configurations" in _card(tree, str(tree / "run"), "--keep", "0.25", code=2).output


def test_card_says_what_is_not_measured(tree: Path) -> None:
    (tree / "dataset.npz").unlink()
    _card(tree)
    text = (tree / "models" / "README.md").read_text()
    assert text.count("Not measured yet") == 2
    assert "No curve of this training" in text and "`dataset.npz` is not in this tree" in text


def test_the_card_of_another_hand_has_its_own_results(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hand, "DEFAULT", "another")
    words = ["publish", "--name", "tiny", "--models-dir", str(tree / "models")]
    dgs([*words, "--dataset", str(tree / "dataset.npz")])
    text = (tree / "models" / "README.md").read_text()
    assert f"no result of an experiment is in `docs/results/{hand.HAND.name}`" in text


@pytest.mark.parametrize(
    ("harm", "code"),
    [
        (lambda tree: (tree / "models" / "tiny.pt").write_bytes(b"x"), "109 WEIGHTS_ALTERED"),
        (lambda tree: (tree / "models" / "tiny.pt").unlink(), "108 WEIGHTS_MISSING"),
        (lambda tree: save_network(eager_network(), tree / "models", "tiny"), "107 REQUEST_INVALID"),
        (lambda tree: (tree / "dataset.npz").write_bytes(b"x"), "107 REQUEST_INVALID"),
        (
            lambda tree: [
                (tree / "results").mkdir(),
                (tree / "results" / "a.json").write_text('{"paper": ["table_2"], "text": "", "rows": [{}]}'),
            ],
            "107 REQUEST_INVALID",
        ),
        (
            lambda tree: [
                (tree / "results" / "speed").mkdir(parents=True),
                (tree / "results" / "speed" / "a.json").write_text("[1]"),
            ],
            "107 REQUEST_INVALID",
        ),
    ],
)
def test_no_card_from_files_that_are_none(tree: Path, harm, code: str) -> None:
    harm(tree)
    assert code in _card(tree, code=2).stderr
    assert not (tree / "models" / "README.md").exists()


def test_plot_of_a_training_folder(tmp_path: Path) -> None:
    dgs(["plot-curve", str(_curve(tmp_path / "run"))])
    image = cv2.imread(str(tmp_path / "run" / "curve.png")).reshape(-1, 3).astype(int)
    teal = (abs(image - [141, 139, 15]).max(axis=1) < 40).sum()
    assert teal > 200, "there are lines"


def test_every_deviation_is_told_with_its_reason() -> None:
    rows = read_data("deviations")
    assert len(rows) >= 12
    for row in rows:
        assert set(row) == {"what", "paper", "here", "why", "option"}
        assert all(isinstance(text, str) and "|" not in text for text in row.values())
        assert all(row[key] for key in ("what", "paper", "here", "why"))

"""From what a training starts: nothing, other weights, or its own checkpoint."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.network import PRESETS, DGSNet, load_network, save_network
from dgs_grasp_planner.network.weights import file_sha256
from dgs_learning.dataset import save_dataset
from dgs_learning.training.__main__ import main
from dgs_learning.training.settings import TrainingSettings
from dgs_learning.training.start import TrainingFiles, start_training
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.commands import dgs
from tests.support.refused import refused

SHORT = [
    "--preset", "tiny", "--batch", "2", "--warmup", "0", "--workers", "0", "--threads", "1",
    "--held-out-scenes", "1", "--views-per-scene", "1",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset, and weights that stand for those of an earlier training."""
    out = tmp_path_factory.mktemp("start")
    save_dataset(out / "dataset.npz", tiny_dataset())
    torch.manual_seed(11)
    save_network(DGSNet(PRESETS["tiny"]), out, "earlier", {"step": 70})
    return out


def _run(folder: Path, out: Path, *options: str) -> int:
    files = ["--dataset", str(folder / "dataset.npz"), "--cache", str(folder / "views"), "--out", str(out)]
    return main([*files, *SHORT, *options])


def test_a_training_starts_from_given_weights_and_then_from_its_own(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, init = tmp_path / "run", ["--init", str(folder / "earlier.pt")]
    assert _run(folder, out, *init, "--steps", "1", "--learning-rate", "1e-6") == 0
    assert f"from the weights {folder / 'earlier.pt'}" in capsys.readouterr().out
    earlier, info = load_network(folder, "earlier")
    trained, _ = load_network(out, "latest")
    moved = [
        (a - b).abs().max().item() for a, b in zip(earlier.parameters(), trained.parameters(), strict=True)
    ]
    assert max(moved) < 2e-3, "one step of 1e-6, and half precision in the file"
    notes = json.loads((out / "latest.json").read_text())["notes"]
    assert notes["init"] == {"model_id": "earlier", "sha256": info.sha256, "step": 70}
    assert notes["dataset"] == {"file": "dataset.npz", "sha256": file_sha256(folder / "dataset.npz")}
    # The checkpoint goes before the weights, and remembers them.
    assert _run(folder, out, "--steps", "2") == 0
    assert "resumed at step 1" in capsys.readouterr().out
    assert json.loads((out / "latest.json").read_text())["notes"]["init"]["model_id"] == "earlier"
    assert _run(folder, tmp_path / "scratch", "--steps", "1") == 0
    assert "from scratch" in capsys.readouterr().out
    assert json.loads((tmp_path / "scratch" / "latest.json").read_text())["notes"]["init"] is None


def test_another_dataset_is_no_way_to_go_on(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(folder, tmp_path / "run", "--steps", "1") == 0
    save_dataset(tmp_path / "dataset.npz", tiny_dataset(4))
    assert _run(tmp_path, tmp_path / "run", "--steps", "2") == 2
    assert "is of another training" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--out", "--cache"])
def test_a_folder_that_cannot_be_made_is_named(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    dataset = folder / "dataset.npz"
    assert _run(folder, tmp_path / "run", option, str(dataset / "sub"), "--steps", "1") == 2
    assert f"folder cannot be made: [Errno 20] Not a directory: '{dataset}" in capsys.readouterr().err


def test_weights_that_do_not_fit_or_are_not_there_are_refused(folder: Path, tmp_path: Path) -> None:
    save_network(DGSNet(replace(PRESETS["tiny"], voxel_size=0.01)), tmp_path, "coarse")
    settings = TrainingSettings(steps=1, workers=0)
    for init, code, words in (
        (tmp_path / "coarse", ErrorCode.REQUEST_INVALID, "voxel_size 0.01 instead of 0.008"),
        (tmp_path / "none", ErrorCode.WEIGHTS_MISSING, "none.pt"),
    ):
        with refused(code, words):
            start_training(
                "tiny", TrainingFiles(folder / "dataset.npz", tmp_path / "out", init=init), settings
            )
    assert not (tmp_path / "out").exists()


def test_the_command_finds_shipped_weights_by_name(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DGS_MODELS_DIR", str(folder))
    words = ["train", "--preset", "tiny", "--out", str(tmp_path / "run"), "--steps", "1", "--batch", "1",
             "--workers", "0", "--held-out", "1", "--views", "1", "--cache", str(folder / "views")]  # fmt: skip
    assert f"from the weights {folder / 'earlier'}" in dgs([*words, "--init", "earlier"]).output
    dgs([*words, "--init", "unknown"], 2)

"""Bad input ends every command with a sentence and exit code 2, before any work and without a traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dgs_learning.cli.app import app
from dgs_learning.paths import dataset_file

SHIPPED = str(dataset_file())


def refusal(*arguments: str | Path) -> str:
    """What a command that is refused says."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    return " ".join(result.output.split())


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """The first 200 kB of a dataset file."""
    path = tmp_path / "damaged.npz"
    path.write_bytes(dataset_file().read_bytes()[:200_000])
    return path


@pytest.mark.parametrize(
    "command",
    [("inspect",), ("validate", "--dataset"), ("grasps", "--known"), ("export", "--out", "x", "--dataset")],
)
def test_a_damaged_dataset_is_refused(
    command: tuple[str, ...], damaged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "damaged.npz cannot be read: it is no .npz file, or damaged" in refusal(*command, damaged)
    assert {path.name for path in tmp_path.iterdir()} == {"damaged.npz"}


def test_other_arrays_are_no_dataset(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    assert "it has version 0, this program reads" in refusal("inspect", tmp_path / "other.npz")
    np.save(tmp_path / "one.npy", np.zeros(3))
    assert "it is no .npz file" in refusal("inspect", tmp_path / "one.npy")


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("predict cloud.ply --seed -1", "Invalid value for '--seed'"),
        ("predict cloud.ply --threads 5000", "Invalid value for '--threads'"),
        ("predict cloud.ply --picture hands.xyz", "hands.xyz is no name of a PNG"),
        ("predict depth.png --cloud-frame base_link", "is for clouds"),
        ("predict cloud.npy --cloud-frame moon", "'moon' is not one of 'camera', 'base_link'"),
        ("predict cloud.npy --device tpu", "'tpu' is not one of 'cpu', 'cuda', 'auto'"),
        ("evaluate --out run --seed -1", "Invalid value for '--seed'"),
        ("evaluate --out run --scenes 0", "Invalid value for '--scenes'"),
        ("evaluate --out run --objects-per-scene 6-4", "'6-4' is neither a number nor a range"),
        ("evaluate --out run --proposers best", "no proposer named 'best'"),
        ("evaluate --out run --objects nowhere", "no object catalogue"),
        ("evaluate --out run --arm --workspace 0.6 0.6", "camera and workspace are the cell's"),
        (
            "experiment luck --out run",
            "no experiment named 'luck'; there are exam, glass, growth, labels, loss_chain",
        ),
        ("experiment loss_chain --only luck --out run", "no row named 'luck'; there are replay"),
        ("experiment exam --out run", "no object catalogue"),  # of its last rows
        ("experiment growth --weights none/none --out run", "108 WEIGHTS_MISSING"),
        ("trials --out run --scenes many", "'many' is neither a number nor a range"),
        ("trials --out run --scenes 20", "no scene is from 20 to before 20"),
        ("train --device gpu", "there is no device 'gpu'"),
        ("train --device mps", "there is no device 'mps'"),
        ("train-shape-completion --device gpu", "there is no device 'gpu'"),
        ("bench-training --preset huge", "107 REQUEST_INVALID: no preset 'huge'"),
        ("bench-training --dataset none.npz", "107 REQUEST_INVALID: the dataset none.npz"),
        ("bench-inference --models-dir .", "108 WEIGHTS_MISSING"),
        ("plot-curve .", "107 REQUEST_INVALID: no curves to draw"),
        ("inspect none.npz", "there is no dataset at none.npz"),
        ("validate --dataset none.npz", "there is no dataset at none.npz"),
        ("validate --stage 2 --drop kept.npz", "use it with --stage 1"),
        ("validate --shape-class cube", "there is no shape class cube"),
        ("import none.stl --out objects", "none.stl does not exist"),
        ("import doc.md --out doc.md", "is a file"),
        ("export --out run --stage-one doc.md", "is a file"),
        ("export --out doc.md/run", "Not a directory: 'doc.md/run'"),
        ("experiment loss_chain --out doc.md", "is a file"),
        ("exam --out doc.md", "is a file"),
        ("trials --out doc.md", "is a file"),
        ("bench-planning --out doc.md", "is a file"),
        ("train-completion --out doc.md", "is a file"),
        ("train-shape-completion --out doc.md", "is a file"),
        ("train --out doc.md", "is a file"),
        ("train --cache doc.md", "is a file"),
        ("fit-success . --out model.json", "make some with `dgs trials`"),
        ("scenes --out mine.npz --count -5", "Invalid value for '--count'"),
        ("scenes --count 1", "Missing option '--out'"),
        ("scenes --count 1 --out mine.npz", "run `dgs grasps` first"),
        ("scenes --out .", "is a directory"),
        ("validate --drop .", "is a directory"),
        ("grasps --target -1", "Invalid value for '--target'"),
        ("grasps --known nowhere.npz", "nowhere.npz"),
        ("validate --workers -1", "Invalid value for '--workers'"),
        ("validate --cluster tcp://127.0.0.1:9", "needs the backend dask, loky stays on this machine"),
        ("validate --backend slurm", "'slurm' is not one of 'loky', 'dask'"),
        ("validate --fingers 9", "no grasp"),
        ("train --seed -1", "seed is -1, it must be at least 0"),
        ("exam --real nowhere", "there is no folder nowhere"),
        ("exam --only real_pybullet", "--real FOLDER"),
        ("exam --doc nowhere.md", "nowhere.md"),
        ("exam --json .", "is a directory"),
        ("report exam.json --doc doc.md", "is no result of `dgs experiment`"),
        ("report .", "it is no finished run of `dgs evaluate`"),
    ],
)
def test_bad_options_are_refused_before_any_work(
    command: str,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DGS_DATA_DIR", "data")
    (tmp_path / "exam.json").write_text('{"experiment": "exam", "rows": []}')
    (tmp_path / "doc.md").touch()
    out = refusal(*command.split())
    assert said in f"{out} {capfd.readouterr().err}"
    assert {path.name for path in tmp_path.iterdir()} == {"exam.json", "doc.md"}


def test_units_stand_in_the_help() -> None:
    result = CliRunner().invoke(app, ["predict", "--help"])
    assert "A cloud [m] or a 16-bit depth PNG [mm]." in result.output

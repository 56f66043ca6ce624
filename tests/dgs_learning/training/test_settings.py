"""What the training loop stands on: sampling, curves, several processes, a machine without the rest of the suite."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_learning.dataset import save_dataset
from dgs_learning.training.__main__ import main, parser
from dgs_learning.training.curve import HELD_OUT, TRAIN, CurveLog, read_curve
from dgs_learning.training.settings import Sampler, TrainingSettings, learning_rate
from dgs_learning.training.train import find_device
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.refused import refused

ROOT = Path(__file__).resolve().parents[3]
SOURCE_ROOTS = [
    ROOT / name
    for name in (
        "dgs_learning",
        "dgs_grasp_planner",
        "dgs_perception",
        "dgs_sim_bridge",
        "ros2_ws/src/dgs_description",
    )
]
ABSENT = (
    "pybullet", "open3d", "rclpy", "typer", "rich", "trimesh", "coacd", "cv2", "matplotlib", "joblib", "tqdm",
    "h5py", "jinja2", "rosbags", "pinocchio", "PIL", "dgs_interfaces",
)  # fmt: skip


def _bare_environment() -> dict[str, str]:
    """Only the source roots that docs/training.md names."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("ROS", "AMENT", "PYTHON"))}
    return environment | {"PYTHONPATH": ":".join(map(str, SOURCE_ROOTS)), "OMP_NUM_THREADS": "1"}


def test_training_needs_torch_numpy_scipy_and_yaml_only() -> None:
    code = f"""
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in {ABSENT!r}:
            raise ModuleNotFoundError(f'{{name}} is not installed on a bare machine', name=name)
sys.meta_path.insert(0, Refuse())
import dgs_learning.training.train, dgs_learning.training.start, dgs_learning.training.__main__
print(sorted({{name.split('.')[0] for name in sys.modules if name.split('.')[0].startswith('dgs_')}}))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env=_bare_environment(), capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    packages = ["dgs_description", "dgs_grasp_planner", "dgs_learning", "dgs_perception", "dgs_sim_bridge"]
    assert done.stdout.strip() == str(packages)


def test_a_step_is_the_same_batch_whoever_shares_it_and_wherever_it_starts() -> None:
    settings = TrainingSettings(steps=9, batch=6, seed=4)
    whole = list(Sampler(settings.for_scenes(20), 0))
    assert len(whole) == len(Sampler(settings.for_scenes(20), 0)) == 9
    assert whole[3:] == list(Sampler(settings.for_scenes(20), 3))
    shares = [list(Sampler(settings.for_scenes(20), 0, rank, 3)) for rank in range(3)]
    for step, batch in enumerate(whole):
        assert len({scene for scene, _, _ in batch}) == 6, "no scene twice in a batch"
        assert sorted(key for share in shares for key in share[step]) == sorted(batch)
        assert [len(share[step]) for share in shares] == [2, 2, 2]
    assert list(Sampler(TrainingSettings(steps=9, batch=6, seed=5).for_scenes(20), 0)) != whole


def test_a_batch_may_be_larger_than_the_number_of_scenes() -> None:
    (batch,) = islice(Sampler(TrainingSettings(steps=1, batch=10).for_scenes(4), 0), 1)
    counts = np.bincount([scene for scene, _, _ in batch], minlength=4)
    assert counts.sum() == 10 and counts.min() >= 2


@pytest.mark.parametrize(
    ("scenes", "processes", "wishes"),
    [
        (9, 3, {"batch": 10}),
        (9, 1, {"steps": -1}),
        (9, 1, {"epochs": 0.0}),
        (9, 1, {"epochs": float("nan")}),
        (9, 1, {"minutes": float("nan")}),
        (9, 1, {"ema": -0.1}),
        (9, 1, {"checkpoint_minutes": float("nan")}),
        (9, 1, {"precision": "fp8"}),
        (9, 1, {"workers": -1}),
        (9, 1, {"learning_rate": 0.0}),
    ],
)
def test_impossible_settings_are_refused(scenes: int, processes: int, wishes: dict) -> None:
    with refused(ErrorCode.REQUEST_INVALID):
        Sampler(TrainingSettings(**wishes).for_scenes(scenes), 0, 0, processes)


def test_scenes_that_are_trained_on() -> None:
    assert TrainingSettings().scenes_of(240) == 236
    assert TrainingSettings(held_out_scenes=8, training_scenes=48).scenes_of(240) == 48
    with pytest.raises(DgsError, match="of 4, 4 are held out"):
        TrainingSettings().scenes_of(4)
    with pytest.raises(DgsError, match="only 236 are not"):
        TrainingSettings(training_scenes=237).scenes_of(240)


def test_epochs_and_steps_agree() -> None:
    """The paper's 240 scenes with 256 viewpoints, batch 10 and 40 epochs."""
    whole = TrainingSettings().for_scenes(240)
    assert (whole.epochs, whole.steps) == (40.0, 40 * 240 * 256 // 10)
    assert len(Sampler(TrainingSettings(epochs=0.5, views_per_scene=16).for_scenes(240), 2)) == 192 - 2
    by_steps = TrainingSettings(steps=96, views_per_scene=16).for_scenes(240)
    assert (by_steps.epochs, by_steps.steps) == (0.25, 96)
    assert by_steps.for_scenes(240) == by_steps
    assert TrainingSettings(epochs=1e-6).for_scenes(4).steps == 1


def test_learning_rate_warms_up_and_falls_to_two_percent() -> None:
    settings = TrainingSettings(steps=1000, warmup=100, learning_rate=1e-3)
    assert learning_rate(0, settings) == pytest.approx(1e-5)
    assert learning_rate(100, settings) == pytest.approx(1e-3)
    assert learning_rate(550, settings) == pytest.approx(1e-3 * (0.02 + 0.98 * 0.5))
    assert learning_rate(1000, settings) == pytest.approx(2e-5)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_gpu_that_is_absent_is_not_replaced_by_the_cpu() -> None:
    with pytest.raises(DgsError, match="torch sees 0"):
        find_device("cuda")


def test_curve_survives_new_columns_a_resume_and_half_a_row(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text("step,split,samples_per_s,loss\n10,train,1.5,3.25\n20,train,1.5,3\n")
    log = CurveLog(path)
    log.append(20, HELD_OUT, {"loss": 4.0})
    log.append(30, TRAIN, {"samples_per_s": 2.0, "loss": 2.5, "data_s": float("nan")})
    curve = read_curve(path)
    assert curve["train"]["step"].tolist() == [10, 20, 30]
    assert curve["train"]["loss"].tolist() == [3.25, 3.0, 2.5]
    assert np.isnan(curve["train"]["data_s"]).all()
    assert curve["held_out"]["loss"].tolist() == [4.0] and np.isnan(curve["held_out"]["samples_per_s"][0])
    with path.open("a") as file:
        file.write("40,tra")
    CurveLog(path, 20).append(30, TRAIN, {"loss": 2.75})
    assert read_curve(path)["train"]["loss"].tolist() == [3.25, 3.0, 2.75]
    assert path.read_text().splitlines()[0] == "step,split,samples_per_s,loss,data_s"


def test_another_table_is_no_curve(tmp_path: Path) -> None:
    (tmp_path / "curve.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ValueError, match="no table of curves"):
        read_curve(tmp_path / "curve.csv")


def test_the_bare_command_refuses_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--dataset", str(tmp_path / "none.npz"), "--out", str(tmp_path)]) == 2
    assert "107 REQUEST_INVALID: the dataset" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(280)
def test_two_processes_train_like_one(tmp_path: Path) -> None:
    """Both processes get the same sample, so that the mean of their gradients is that of the batch of one process."""
    save_dataset(tmp_path / "dataset.npz", tiny_dataset(1))
    options = [
        "-m", "dgs_learning.training", "--dataset", str(tmp_path / "dataset.npz"), "--preset", "tiny", "--steps", "4",
        "--batch", "2", "--held-out-scenes", "0", "--views-per-scene", "1", "--workers", "0", "--threads", "1",
        "--cache", str(tmp_path / "views"), "--warmup", "0", "--precision", "fp32",
    ]  # fmt: skip
    launch = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    states = []
    for name, words in (("one", options), ("two", [*launch, *options])):
        out = tmp_path / name
        done = subprocess.run(
            [sys.executable, *words, "--out", str(out)],
            env=_bare_environment(), capture_output=True, text=True, timeout=130,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("step 4/4") == 1, "one process prints"
        assert len(read_curve(out / "curve.csv")["train"]["step"]) == 1
        states.append(torch.load(out / "checkpoint.pt", weights_only=True))
    assert states[0]["step"] == states[1]["step"] == 4
    for name, value in states[0]["net"].items():
        torch.testing.assert_close(states[1]["net"][name], value, rtol=1e-3, atol=1e-4, msg=name)


def test_the_documented_way_on_a_bare_machine() -> None:
    """tests/test_commands.py reads the other commands."""
    text = (ROOT / "docs" / "training.md").read_text()
    assert f"export PYTHONPATH={':'.join(str(root.relative_to(ROOT)) for root in SOURCE_ROOTS)}\n" in text
    of_gpus_and_of_cores = re.findall(r"^torchrun .* -m dgs_learning.training (.*)", text, re.MULTILINE)
    assert len(of_gpus_and_of_cores) == 2
    for options in of_gpus_and_of_cores:
        parser().parse_args(options.split())

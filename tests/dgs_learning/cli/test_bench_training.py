"""The measurement of the training's speed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dgs_learning.dataset import save_dataset
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.commands import dgs


def test_stages_add_up_to_the_rate(tmp_path: Path) -> None:
    save_dataset(tmp_path / "dataset.npz", tiny_dataset(6))
    words = ["bench-training", "--preset", "tiny", "--batch", "2", "--steps", "2", "--dataset"]
    done = dgs([*words, str(tmp_path / "dataset.npz"), "--json", str(tmp_path / "out" / "speed.json")])
    measured = json.loads((tmp_path / "out" / "speed.json").read_text())
    stages = measured["stages"]
    assert list(stages) == ["view", "labels and tables", "forward", "backward", "optimiser"]
    assert min(stages.values()) > 0
    assert measured["samples_per_s"] == pytest.approx(1 / sum(stages.values()), rel=1e-2)
    assert measured["peak_memory_mb"] > 100 and measured["dataset"]["scenes"] == 6
    assert f"{measured['samples_per_s']:.2f} samples/s" in done.output

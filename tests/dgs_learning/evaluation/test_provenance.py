"""What a run says about the files that decide its numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgs_description.paths import models_dir
from dgs_grasp_planner.network.weights import file_sha256
from dgs_learning.evaluation import provenance
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.provenance import describe_planner


def test_another_ranking_is_another_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    row = Row("one", proposers=("top_down",))
    shipped = describe_planner(row)
    other = tmp_path / "success.json"
    other.write_text("{}")
    monkeypatch.setattr(provenance, "RANKING", other)
    changed = describe_planner(row)
    assert {key for key in shipped if shipped[key] != changed[key]} == {"success_sha256"}


def test_weights_that_fill_in_depth_are_named_where_they_are_used(tmp_path: Path) -> None:
    network = tmp_path / "stereo.onnx"
    network.write_bytes(b"weights")
    used = {"completed": models_dir() / "depth_completion.pt", str(network): network}
    for source, file in used.items():
        described = describe_planner(Row("one", condition=Condition(depth_from=source)))
        assert described["depth_sha256"] == file_sha256(file)[:16]
    assert "depth_sha256" not in describe_planner(Row("one"))

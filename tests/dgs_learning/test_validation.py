"""Stored grasps simulated again: what is drawn, what is refused, what an interrupted run keeps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from dgs_learning.cli import app
from dgs_learning.dataset import save_dataset
from dgs_learning.parallel import Engine
from dgs_learning.validation.run import draw, read_journal, table, total_grasps, validate
from tests.dgs_learning.small_dataset import small_dataset, small_dataset_file


def test_a_larger_draw_contains_the_smaller_and_seeds_differ() -> None:
    assert draw(1000, 50, 3, 1) == draw(1000, 80, 3, 1)[:50]
    assert draw(1000, 50, 3, 1) != draw(1000, 50, 4, 1)
    assert draw(1000, 50, 3, 1) != draw(1000, 50, 3, 2)
    assert sorted(draw(5, 99, 0, 1)) == [0, 1, 2, 3, 4]


def test_stored_grasps_hold_again_in_other_poses(tmp_path: Path) -> None:
    summary = validate(small_dataset_file(), 1, 6, 0, Engine(1), tmp_path)
    assert summary["tried"] == min(6, total_grasps(small_dataset(), 1))
    assert summary["passed"] >= 0.7 * summary["tried"]
    assert 0 <= summary["penetration_mm"]["mean"] <= summary["penetration_mm"]["p95"] + 1e-9 < 2.2
    assert sum(row["tried"] for row in summary["by_class"].values()) == summary["tried"]
    assert f"{summary['passed']} of {summary['tried']} passed" in table(summary)


def test_scene_grasps_lift_their_object(tmp_path: Path) -> None:
    summary = validate(small_dataset_file(), 2, 4, 0, Engine(1), tmp_path)
    assert summary["tried"] == 4
    assert summary["passed"] >= 2
    assert sum(summary["ends"].values()) == 4
    assert summary["ends"].get("lifted", 0) == summary["passed"]


def test_a_hand_that_does_not_close_is_found_out(tmp_path: Path) -> None:
    data = small_dataset()
    file = tmp_path / "open.npz"
    save_dataset(file, replace(data, joints=np.zeros_like(data.joints)))
    summary = validate(file, 1, 4, 0, Engine(1), tmp_path)
    assert summary["passed"] == 0


def test_a_hand_in_the_object_shows_as_penetration(tmp_path: Path) -> None:
    data = small_dataset()
    file = tmp_path / "deep.npz"
    save_dataset(file, replace(data, position=np.zeros_like(data.position)))
    summary = validate(file, 1, 3, 0, Engine(1), tmp_path)
    assert summary["penetration_mm"]["mean"] > 3


def test_an_interrupted_run_goes_on_after_a_torn_line(tmp_path: Path) -> None:
    first = validate(small_dataset_file(), 1, 3, 0, Engine(1), tmp_path)
    (journal,) = tmp_path.glob("*.jsonl")
    lines = journal.read_text().splitlines(keepends=True)
    marked = json.loads(lines[0]) | {"how": "kept from before"}
    journal.write_text(json.dumps(marked) + "\n" + lines[1] + lines[2][:20])
    assert len(read_journal(journal)) == 2
    again = validate(small_dataset_file(), 1, 3, 0, Engine(1), tmp_path)
    assert again["ends"].get("kept from before") == 1, "a finished check was made again"
    assert again["passed"] == first["passed"]
    assert len(journal.read_text().splitlines()) == 3


def test_command_writes_json_and_names_a_missing_file(tmp_path: Path) -> None:
    words = ["validate", "--stage", "1", "--count", "1", "--workers", "1", "--folder", str(tmp_path)]
    out = tmp_path / "v.json"
    result = CliRunner().invoke(app, [*words, "--dataset", str(small_dataset_file()), "--json", str(out)])
    assert result.exit_code == 0, result.output
    written = json.loads(out.read_text())
    assert {"tried", "passed", "penetration_mm", "seed", "revision", "stage"} <= written.keys()
    missing = CliRunner().invoke(app, [*words, "--dataset", str(tmp_path / "none.npz")])
    assert missing.exit_code == 2 and "no dataset" in missing.output


def test_no_third_stage(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no stage 3"):
        validate(small_dataset_file(), 3, 1, 0, Engine(1), tmp_path)

"""Pooling of several demo runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dgs_bringup.series import main, pool


def run(seed: int, attempts: int, successes: int, cleared: int) -> dict:
    return {
        "seed": seed,
        "objects": 5,
        "attempts": attempts,
        "successes": successes,
        "cleared": cleared,
        "seconds": {"total": 10.0 * attempts},
        "error_code": 0,
        "message": "",
        "revision": "abc",
    }


def test_rates_are_pooled_not_averaged():
    pooled = pool([run(0, 2, 2, 2), run(1, 8, 4, 4)])
    assert pooled["sr"] == 0.6 and pooled["cr"] == 0.6
    assert pooled["seconds_per_attempt"] == 10.0
    assert [row["seed"] for row in pooled["runs"]] == [0, 1]


def test_no_runs_are_refused():
    with pytest.raises(ValueError, match="no run"):
        pool([])


def test_command_writes_the_file_and_names_a_missing_run(tmp_path: Path, capsys: pytest.CaptureFixture):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(run(3, 5, 4, 4)))
    assert main([str(folder), "--json", str(tmp_path / "out" / "demo.json")]) == 0
    assert json.loads((tmp_path / "out" / "demo.json").read_text())["cleared"] == 4
    assert main([str(tmp_path / "none")]) == 2
    assert "summary.json" in capsys.readouterr().err

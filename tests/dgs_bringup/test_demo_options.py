"""Options of the demo are refused before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from dgs_bringup.demo import main

APP = typer.Typer()
APP.command()(main)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--seed -1", "--seed"),
        ("--objects 0", "--objects"),
        ("--objects 31", "0 to 30 are possible"),
        ("--catalogue none.npz", "none.npz"),
        ("--max-attempts 4294967296", "--max-attempts"),
        ("--time-limit -3", "-3"),
        ("--time-limit nan", "nan"),
        ("", ""),
    ],
)
def test_wrong_options_are_refused(tmp_path: Path, words: str, why: str) -> None:
    result = CliRunner().invoke(APP, ["--check", "--out", str(tmp_path / "run"), *words.split()])
    assert result.exit_code == (2 if why else 0) and why in result.output
    assert not (tmp_path / "run").exists()


def test_a_folder_that_holds_a_run_is_not_used_again(tmp_path: Path) -> None:
    (tmp_path / "summary.json").touch()
    result = CliRunner().invoke(APP, ["--check", "--out", str(tmp_path)])
    assert result.exit_code == 2 and "name another folder" in result.output

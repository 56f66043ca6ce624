"""Options of the demo are refused before anything starts; what it says when a file cannot be written."""

from __future__ import annotations

import io
import threading
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from dgs_bringup import demo
from dgs_bringup.demo import main
from dgs_bringup.summary import summarise

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


def test_a_disk_that_is_full_costs_the_files_and_not_the_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [np.zeros((24, 32, 3), np.uint8)]
    monkeypatch.setattr(demo, "RunRecorder", lambda _: SimpleNamespace(frames=frames, label=""))
    console = Console(file=io.StringIO(), width=120)
    run = demo.Demo(SimpleNamespace(node=None), console, Path("/proc/run"), 0)  # type: ignore[arg-type]
    run._save_pictures()
    with pytest.raises(OSError, match=r"summary\.json"):
        run._write(summarise([], {"cup": "bin"}, 1.0, seed=0, error_code=0, message="the table is empty"))
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert "run.gif" in said and "the table is empty" in said and "1 of 1 objects" in said


def test_a_disk_that_is_full_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> int:
        raise OSError(28, "No space left on device", "before.png")

    monkeypatch.setattr(demo, "RosSession", lambda *_, **__: nullcontext())
    monkeypatch.setattr(demo, "Demo", lambda *_: SimpleNamespace(run=fail, stop=None))
    monkeypatch.setattr(demo.signal, "signal", lambda *_: None)
    with pytest.raises(typer.Exit) as ended:
        main(tmp_path / "run")
    assert ended.value.exit_code == 1
    watchdogs = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert all(timer.finished.is_set() for timer in watchdogs)  # one that is left would end this process
    assert "the demo failed: [Errno 28] No space left on device: 'before.png'" in capsys.readouterr().out


def test_the_run_folder_is_printed_as_it_is_called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "RunRecorder", lambda _: None)
    (tmp_path / "cups [red]").mkdir()
    console = Console(file=io.StringIO(), width=120)
    run = demo.Demo(SimpleNamespace(node=None), console, tmp_path / "cups [red]", 0)  # type: ignore[arg-type]
    run._write(summarise([], {}, 1.0, seed=0, error_code=0, message=""))
    assert f"run folder: {tmp_path}/cups [red]\n" in console.file.getvalue()  # type: ignore[attr-defined]

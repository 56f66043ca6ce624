"""The models folder: given, by the environment, or beside the sources."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand_file import load_hand
from dgs_description.paths import models_dir, repository, revision, weights_dir
from tests.support.environment import REPO_ROOT
from tests.support.refused import refused


def test_models_dir(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DGS_MODELS_DIR", raising=False)
    assert repository() == REPO_ROOT and models_dir() == REPO_ROOT / "models"
    monkeypatch.setenv("DGS_MODELS_DIR", str(tmp_path))
    assert models_dir() == tmp_path
    assert models_dir("/somewhere") == Path("/somewhere")


def test_a_hand_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DGS_MODELS_DIR", raising=False)
    assert weights_dir() == models_dir()
    monkeypatch.setattr("dgs_description.paths.HAND", load_hand("allegro"))
    assert weights_dir() == models_dir() / "allegro"
    assert weights_dir("/somewhere") == Path("/somewhere")


def test_outside_of_a_checkout_a_sentence_says_what_to_set(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("DGS_MODELS_DIR", raising=False)
    monkeypatch.setattr("dgs_description.paths.__file__", str(tmp_path / "paths.py"))
    with refused(ErrorCode.DESCRIPTION_MISSING, "DGS_MODELS_DIR"):
        models_dir()
    assert models_dir("/somewhere") == Path("/somewhere")


def test_revision_is_a_short_commit_or_unknown(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert re.fullmatch(r"[0-9a-f]{10}\+?|unknown", revision())
    monkeypatch.setattr("dgs_description.paths.repository", lambda: tmp_path)
    assert revision() == "unknown"


def test_revision_notices_that_a_package_has_other_data(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def git(*words: str) -> None:
        own = ["-c", "user.name=test", "-c", "user.email=test@localhost"]
        subprocess.run(["git", "-C", str(tmp_path), *own, *words], check=True, capture_output=True)

    for name in ("package/success.json", "docs/results.json"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("{}")
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    monkeypatch.setattr("dgs_description.paths.repository", lambda: tmp_path)
    (tmp_path / "docs" / "results.json").write_text("[]")
    assert not revision().endswith("+"), "a measured result is no part of the program"
    (tmp_path / "package" / "success.json").write_text("[]")
    assert revision().endswith("+")

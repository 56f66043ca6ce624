"""Reading of `.npz` files that come from anywhere."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from dgs_description.arrays import load_arrays, save_arrays
from tests.support.environment import REPO_ROOT


class Payload:
    """What a hostile pickle does: here it makes a file."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self) -> tuple:
        return os.mkdir, (str(self.mark),)


def test_what_was_saved_is_read(tmp_path: Path) -> None:
    save_arrays(tmp_path / "a.npz", {"one": np.arange(3), "name": ["x"]})
    arrays = load_arrays(tmp_path / "a.npz")
    assert arrays["one"].tolist() == [0, 1, 2] and arrays["name"].tolist() == ["x"]


def test_a_file_cannot_run_code(tmp_path: Path) -> None:
    hostile = np.array([Payload(tmp_path / "mark")], dtype=object)
    np.savez(tmp_path / "a.npz", name=hostile)
    with pytest.raises(ValueError, match="allow_pickle"):
        load_arrays(tmp_path / "a.npz")
    assert not (tmp_path / "mark").exists()


def test_a_small_file_cannot_take_the_memory(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(10**6))
    assert (tmp_path / "a.npz").stat().st_size < 20_000
    with pytest.raises(ValueError, match="unpacks to 8000"):
        load_arrays(tmp_path / "a.npz", most=10**6)


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04" + 100 * b"x"])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(ValueError):
        load_arrays(tmp_path / "a.npz")


def test_no_reader_of_the_suite_takes_pickles_or_code() -> None:
    sources = [
        p
        for p in REPO_ROOT.glob("**/*.py")
        if p.relative_to(REPO_ROOT).parts[0].startswith(("dgs_", "ros2_ws"))
    ]
    sources = [p for p in sources if not {"install", "build"} & set(p.parts)]
    assert len(sources) > 150
    for path in sources:
        text = path.read_text()
        assert not re.search(
            r"\b(import pickle|pickle\.load|import shelve|joblib\.load|yaml\.load\(|yaml\.unsafe)", text
        ), path
        assert not re.search(r"allow_pickle=True|(?<![\w.])(eval|exec)\(", text), path
        for call in re.findall(r"np\.load\(.*", text):
            assert "allow_pickle=False" in call, f"{path}: {call}"
        for call in re.findall(r"torch\.load\(.*", text):
            assert "weights_only=True" in call, f"{path}: {call}"

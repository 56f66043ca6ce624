"""`dgs evaluate` refuses what it cannot run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.commands import dgs


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--proposers", "best"], "no proposer named"),
        (["--objects-per-scene", "many"], "neither a number nor a range"),
        (["--ablate", "score"], "no ablation named"),
        (["--objects", "nowhere"], "no object catalogue"),
    ],
)
def test_the_command_refuses_wrong_words(words: list[str], said: str, tmp_path: Path) -> None:
    result = dgs(["evaluate", "--out", str(tmp_path / "run"), *words], 2)
    assert said in " ".join(result.output.replace("│", " ").split())

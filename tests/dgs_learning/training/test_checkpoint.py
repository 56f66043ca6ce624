"""Checkpoints that cannot be read; those of another training are in the tests of the trainings."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_learning.training.checkpoint import read_checkpoint
from tests.support.refused import refused


@pytest.mark.parametrize("whole", [0, 600])
def test_what_was_copied_in_part_is_refused(whole: int, tmp_path: Path) -> None:
    file, state = tmp_path / "checkpoint.pt", {"step": 3, "net": {"weight": torch.ones(1000)}}
    torch.save(state, file)
    assert read_checkpoint(file, torch.device("cpu"), {"seed": 1})["step"] == 3
    file.write_bytes(file.read_bytes()[:whole])
    with refused(ErrorCode.REQUEST_INVALID, "checkpoint.pt cannot be read"):
        read_checkpoint(file, torch.device("cpu"), {})


def test_something_else_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.pt"
    torch.save([1, 2], file)
    with refused(ErrorCode.REQUEST_INVALID, "cannot be read"):
        read_checkpoint(file, torch.device("cpu"), {})

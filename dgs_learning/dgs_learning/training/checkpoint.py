"""Reads the checkpoint with which a training goes on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_learning.made_from import check_same


def read_checkpoint(file: Path, device: torch.device, made_from: Mapping[str, Any]) -> dict[str, Any]:
    """What was saved, on a device.

    Raises:
        DgsError: REQUEST_INVALID: it cannot be read, or its `made_from` differs.
    """
    try:
        state: dict[str, Any] = torch.load(file, map_location=device, weights_only=True)
        made = state.get("made_from", {})
    except Exception as error:  # torch raises many kinds here; all mean the same to the user
        damaged = f"{file} cannot be read, name another folder: {error!r}"
        raise DgsError(ErrorCode.REQUEST_INVALID, damaged) from error
    check_same(f"{file} is of another training, name another folder", made, made_from)
    return state

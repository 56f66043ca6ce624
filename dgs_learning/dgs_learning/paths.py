"""Where the repository's data lies: found from the package, overridden by environment variables."""

from __future__ import annotations

import os
from pathlib import Path

from dgs_description.paths import repository, weights_dir


def data_dir() -> Path:
    """Intermediate results of the generation, not tracked (`DGS_DATA_DIR`)."""
    return Path(os.environ.get("DGS_DATA_DIR") or repository() / "data")


def dataset_file() -> Path:
    """The compact dataset of the hand."""
    return weights_dir() / "dataset.npz"


def kept_folder(folder: Path, made_by: str) -> Path | None:
    """Where results of a `revision` are kept in a folder; None where it does not say which code made them."""
    return None if made_by == "unknown" or made_by.endswith("+") else folder / made_by

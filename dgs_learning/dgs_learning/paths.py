"""Where the repository's data lies: found from the package, overridden by environment variables."""

from __future__ import annotations

import os
from pathlib import Path

from dgs_description.paths import models_dir, repository


def data_dir() -> Path:
    """Intermediate results of the generation, not tracked (`DGS_DATA_DIR`)."""
    return Path(os.environ.get("DGS_DATA_DIR", repository() / "data"))


def dataset_file() -> Path:
    """The compact dataset."""
    return models_dir() / "dataset.npz"

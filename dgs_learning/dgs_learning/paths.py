"""Where the repository's data lies: found from the package, overridden by environment variables."""

from __future__ import annotations

import os
from pathlib import Path


def repository() -> Path:
    """Root of the source tree."""
    return Path(__file__).resolve().parents[2]


def models_dir() -> Path:
    """Weights, model card, dataset and object catalogues (`DGS_MODELS_DIR`)."""
    return Path(os.environ.get("DGS_MODELS_DIR", repository() / "models"))


def data_dir() -> Path:
    """Intermediate results of the generation, not tracked (`DGS_DATA_DIR`)."""
    return Path(os.environ.get("DGS_DATA_DIR", repository() / "data"))


def dataset_file() -> Path:
    """The compact dataset."""
    return models_dir() / "dataset.npz"


def novel_file() -> Path:
    """The catalogue of novel test objects."""
    return models_dir() / "novel_objects.npz"

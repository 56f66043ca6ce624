"""Finds object catalogues: "novel" and "train" of the models folder, or any file or folder."""

from __future__ import annotations

import os
from pathlib import Path

from dgs_description.errors import ErrorCode
from dgs_sim_bridge.render.object_model import CatalogueError, ObjectModel, load_catalogue

NAMES = {"novel": "novel_objects.npz", "train": "dataset.npz"}
"""Files of the named catalogues in the models folder; the dataset holds the objects that it is about."""


def models_folder(given: str = "") -> Path:
    """The folder with catalogues and weights: `given`, else $DGS_MODELS_DIR, else `models` of the repository.

    Raises:
        CatalogueError: it is not there.
    """
    wanted = given or os.environ.get("DGS_MODELS_DIR", "")
    if wanted:
        folder = Path(wanted).expanduser()
        if folder.is_dir():
            return folder
        raise CatalogueError(ErrorCode.SIM_CATALOGUE, f"the models folder {folder} does not exist")
    # From a source tree, a symlinked install or a colcon install below the repository.
    for parent in Path(__file__).resolve().parents:
        if (parent / "models" / "novel_objects.npz").is_file():
            return parent / "models"
    raise CatalogueError(
        ErrorCode.SIM_CATALOGUE,
        "no models folder found: set the parameter models_dir or DGS_MODELS_DIR to it",
    )


def find_catalogue(name: str, models_dir: str = "") -> list[ObjectModel]:
    """Load a catalogue by name ("novel", "train") or by path.

    Raises:
        CatalogueError: it is not there or cannot be read.
    """
    if name not in NAMES:
        return load_catalogue(Path(name).expanduser())
    path = models_folder(models_dir) / NAMES[name]
    if not path.is_file():
        raise CatalogueError(
            ErrorCode.SIM_CATALOGUE, f"the catalogue {name!r} is missing: there is no {path}"
        )
    return load_catalogue(path)

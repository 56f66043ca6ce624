"""Arrays in `.npz` files: written whole, read without pickles (a file cannot run code) and within a limit of memory."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.files import atomic_write

MAX_BYTES = 2**30
"""Unpacked size above which a file is refused: fifty times the repository's dataset."""


def load_arrays(path: Path, most: int = MAX_BYTES) -> dict[str, NDArray]:
    """All arrays of a `.npz` file by name.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no such file, is damaged, holds objects, or unpacks to more than `most` bytes.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            size = sum(entry.file_size for entry in packed.infolist())
        if size > most:
            raise ValueError(f"it unpacks to {size} bytes, {most} are allowed")
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError):
        raise
    except Exception as error:  # zip, zlib and numpy's header reader raise many kinds
        raise ValueError(f"it is no .npz file, or damaged: {error}") from error


def save_arrays(path: Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write a compressed `.npz` file, whole or not at all; its folder is made."""
    with atomic_write(path) as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)

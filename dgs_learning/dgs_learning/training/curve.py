"""The curves of a training as one CSV file: a row per report, `split` says train or held_out."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgs_description.files import atomic_write

TRAIN, HELD_OUT = "train", "held_out"


class CurveLog:
    """The rows of a file, which is written anew, at once, with every change: there may be new columns."""

    def __init__(self, path: Path, step: float = math.inf):
        """Go on with a file that is there, without its rows after a step: a resumed training makes them anew."""
        rows = _rows(path) if path.exists() else []
        self.path, self._rows = path, [row for row in rows if int(row["step"]) <= step]

    def append(self, step: int, split: str, values: Mapping[str, float]) -> None:
        """Add one row; a NaN is left blank."""
        numbers = {k: "" if math.isnan(v) else f"{v:.6g}" for k, v in values.items()}
        self._rows.append({"step": str(step), "split": split, **numbers})
        names = dict.fromkeys(["step", "split", *(name for row in self._rows for name in row)])
        with atomic_write(self.path, "w") as file:
            writer = csv.DictWriter(file, list(names), restval="")
            writer.writeheader()
            writer.writerows(self._rows)


def read_curve(path: Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Columns by split: `read_curve(path)["train"]["loss"]` is (R,), NaN where blank.

    Raises:
        FileNotFoundError: nothing there.
        ValueError: no such table.
    """
    rows = _rows(path)
    if not rows or not {"step", "split"} <= rows[0].keys():
        raise ValueError(f"{path} is no table of curves")
    names = [name for name in rows[0] if name != "split"]
    splits: dict[str, dict[str, NDArray[np.float64]]] = {}
    for split in dict.fromkeys(row["split"] for row in rows):
        mine = [row for row in rows if row["split"] == split]
        splits[split] = {name: np.array([float(row[name] or "nan") for row in mine]) for name in names}
    return splits


def _rows(path: Path) -> list[dict[str, str]]:
    """Rows by column; a process that was killed leaves half a row."""
    with path.open(newline="") as file:
        return [row for row in csv.DictReader(file) if None not in row.values() and None not in row]

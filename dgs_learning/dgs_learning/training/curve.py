"""The curves of a training as one CSV file: a row per report, `split` says train or held_out."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TRAIN, HELD_OUT = "train", "held_out"
FIRST = ("step", "split")


class CurveLog:
    """Appends rows; a file of an older version with fewer columns is rewritten once."""

    def __init__(self, path: Path):
        self.path = path
        self._columns = _header(path)

    def append(self, step: int, split: str, values: Mapping[str, float]) -> None:
        """Add one row; a NaN is left blank."""
        missing = [name for name in (*FIRST, *values) if name not in self._columns]
        if missing:
            self._rewrite(_rows(self.path), [*self._columns, *missing])
        row = {"step": str(step), "split": split}
        row |= {k: "" if math.isnan(v) else f"{v:.6g}" for k, v in values.items()}
        with self.path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns, restval="").writerow(row)

    def rewind(self, step: int) -> None:
        """Drop the rows after a step: a resumed training makes them anew."""
        rows = _rows(self.path)
        kept = [row for row in rows if int(row["step"]) <= step]
        if len(kept) < len(rows):
            self._rewrite(kept, self._columns)

    def _rewrite(self, rows: Sequence[Mapping[str, str]], columns: Sequence[str]) -> None:
        self._columns = [*FIRST, *(name for name in columns if name not in FIRST)]
        partial = self.path.with_suffix(".partial")
        with partial.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns, restval="")
            writer.writeheader()
            writer.writerows({"split": TRAIN, **row} for row in rows)
        partial.replace(self.path)


def read_curve(path: Path) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Columns by split: `read_curve(path)["train"]["loss"]` is (R,), NaN where blank.

    Raises:
        FileNotFoundError: nothing there.
        ValueError: no such table.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    rows = _rows(path)
    if not rows or "step" not in rows[0]:
        raise ValueError(f"{path} is no table of curves")
    names = [name for name in rows[0] if name != "split"]
    splits: dict[str, dict[str, NDArray[np.float64]]] = {}
    for split in dict.fromkeys(row.get("split", TRAIN) for row in rows):
        mine = [row for row in rows if row.get("split", TRAIN) == split]
        splits[split] = {name: np.array([float(row[name] or "nan") for row in mine]) for name in names}
    return splits


def _header(path: Path) -> list[str]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return next(csv.reader(file), [])


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(newline="") as file:
        # A killed process may leave half a row.
        return [row for row in csv.DictReader(file) if None not in row.values() and None not in row]

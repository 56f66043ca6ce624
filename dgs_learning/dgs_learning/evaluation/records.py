"""The run folder: one JSON file per finished scene, clouds and failures of its attempts, and `attempts.csv`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.files import atomic_write
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_learning.evaluation.proposers.cloud_shape import thinned
from dgs_learning.evaluation.protocol import AttemptRecord, Item, SceneResult

T = TypeVar("T")

CLOUD_STEP = 1e-4
"""Quantisation of kept clouds [m]."""
CSV_COLUMNS = (
    "scene", "attempt", "object_name", "shape_class", "item", "outcome", "score", "source", "seconds", "candidates",
    "pd_mm", "pv_mm3", "pd_closed_mm", "pv_closed_mm3",
)  # fmt: skip


def scene_file(folder: Path, number: int) -> Path:
    """Where the result of a scene lies."""
    return folder / "scenes" / f"scene_{number:04d}.json"


def failure_file(folder: Path, scene: int, attempt: int) -> Path:
    """Where the picture of a failed attempt lies."""
    return folder / "failures" / f"scene_{scene:04d}_{attempt:03d}.jpg"


def claim(folder: Path, described: dict[str, Any]) -> None:
    """Mark the folder as this experiment's; more scenes of the same experiment are welcome.

    Raises:
        ValueError: it is another one's.
    """
    mark, described = folder / "setting.json", json.loads(json.dumps(described))
    if mark.is_file() and any((folder / "scenes").glob("scene_*")):
        there = json.loads(mark.read_text())
        other = {k for k in (there | described) if there.get(k) != described.get(k)} - {"scenes"}
        if other:
            found, wanted = ({k: values.get(k) for k in sorted(other)} for values in (there, described))
            raise ValueError(f"{folder} holds results of another setting: {found} there, {wanted} wanted")
    with atomic_write(mark, "w") as file:
        file.write(json.dumps(described, indent=1) + "\n")


def follow(
    running: Iterable[T | None], total: int, done: list[T], summarise: Callable[[list[T]], dict[str, Any]]
) -> None:
    """Wait for scenes, behind a bar that shows SR and CR so far; what comes is added to those that are `done`.

    Args:
        running: scenes as they end; None = one that failed and is no result.
        total: how many.
    """
    with tqdm(running, total=total, unit="scene") as progress:
        for result in progress:
            if result is not None:
                done.append(result)
                so_far = summarise(done)
                progress.set_postfix(sr=f"{so_far['sr']:.2f}", cr=f"{so_far['cr_pooled']:.2f}")


def save_scene(folder: Path, result: SceneResult, revision: str, clouds: Sequence[NDArray]) -> None:
    """Keep a finished scene; its clouds first, so that a scene with a result has its clouds.

    Args:
        revision: of the program that made it.
        clouds: (N, 3) [m] per attempt.
    """
    path = scene_file(folder, result.scene)
    arrays = {f"cloud_{k:03d}": np.round(c / CLOUD_STEP).astype(np.int16) for k, c in enumerate(clouds)}
    save_arrays(path.with_suffix(".npz"), arrays)
    with atomic_write(path, "w") as file:
        file.write(json.dumps({"revision": revision, **asdict(result)}) + "\n")


def load_scene(folder: Path, number: int) -> tuple[SceneResult, str]:
    """A finished scene and the revision that made it."""
    values = json.loads(scene_file(folder, number).read_text())
    revision = values.pop("revision")
    attempts = tuple(_record(row) for row in values.pop("attempts"))
    items = tuple(Item(**item) for item in values.pop("items", ()))
    return SceneResult(**values, attempts=attempts, items=items), revision


def _record(row: dict[str, Any]) -> AttemptRecord:
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}
    return AttemptRecord(**values)


def load_cloud(folder: Path, scene: int, attempt: int) -> Array:
    """(N, 3) what was seen before an attempt, thinned [m]; empty if it was not kept."""
    path = scene_file(folder, scene).with_suffix(".npz")
    kept = load_arrays(path) if path.is_file() else {}
    return kept.get(f"cloud_{attempt:03d}", np.zeros((0, 3))) * CLOUD_STEP


def cloud_to_keep(points: NDArray) -> Array:
    """A cloud thin enough to keep: objects at 4 mm, the table at 20 mm."""
    values = np.asarray(points, dtype=np.float64)
    high = values[:, 2] > OBJECT_HEIGHT
    return np.concatenate([thinned(values[high], 0.004), thinned(values[~high], 0.02)])


def write_attempts(path: Path, results: Sequence[SceneResult]) -> None:
    """`attempts.csv`: one line per attempt."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, CSV_COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(vars(attempt) for result in results for attempt in result.attempts)

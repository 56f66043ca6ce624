"""Runs stage 1 over a catalogue: parallel, resumable, the same result for the same seed on any number of workers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from dgs_learning.synthesis.stage_one import GraspRecords, synthesise
from dgs_sim_bridge.object_model import ObjectModel


def record_path(folder: Path, model: ObjectModel) -> Path:
    """Where the grasps of one object at one scale lie."""
    return folder / f"{model.name}.npz"


def save_records(path: Path, records: GraspRecords) -> None:
    """Write atomically: a killed run leaves either the whole file or none."""
    partial = path.with_suffix(".partial.npz")
    np.savez_compressed(partial, allow_pickle=False, **vars(records))
    os.replace(partial, path)


def load_records(path: Path) -> GraspRecords:
    """Read what `save_records` wrote."""
    with np.load(path, allow_pickle=False) as data:
        scalars = {"drawn": int, "trials": int, "seconds": float}
        return GraspRecords(**{k: scalars[k](data[k]) if k in scalars else data[k] for k in data.files})


def _one(model: ObjectModel, key: list[int], target: int, max_chunks: int, path: Path) -> int:
    records = synthesise(model, key, target, max_chunks)
    save_records(path, records)
    return len(records)


def generate_grasps(
    models: Sequence[tuple[ObjectModel, list[int]]], folder: Path, target: int, max_chunks: int, workers: int
) -> int:
    """Make the grasps of every model that has none in `folder` yet.

    Args:
        models: objects with the seed key of each; the key, not the order of work, fixes the grasps.
        folder: one file per object appears here.
        target: grasps after which an object is done.
        max_chunks: chunks of draws after which it is done all the same.
        workers: processes.

    Returns:
        number of grasps made in this call.
    """
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(m, key) for m, key in models if not record_path(folder, m).exists()]
    jobs = (delayed(_one)(m, key, target, max_chunks, record_path(folder, m)) for m, key in todo)
    made = 0
    results = Parallel(n_jobs=workers, return_as="generator_unordered", pre_dispatch="2*n_jobs")(jobs)
    with tqdm(results, total=len(todo), unit="object", desc="stage 1") as progress:
        for count in progress:
            made += count
            progress.set_postfix(grasps=made)
    return made

"""A small real dataset, made once per test run: two objects, grasps from the simulation, scenes that settled."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from dgs_learning.dataset import GraspDataset, load_dataset, save_dataset
from dgs_learning.objects import shapes
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.generate import generate_scenes
from dgs_learning.synthesis.sdf import signed_distance
from dgs_learning.synthesis.stage_one import synthesise_chunk
from dgs_sim_bridge.render.object_model import from_parts


@cache
def small_dataset_file() -> Path:
    """Path of the file; the folder lives as long as the process."""
    path = Path(_folder().name) / "small.npz"
    models = [
        from_parts("block_000@1.00", "cuboid", "block", shapes.box([0.05, 0.06, 0.08]), 0.2),
        from_parts("can_000@1.00", "cylinder", "can", shapes.lathe([(0.03, 0), (0.03, 0.1)]), 0.2),
    ]
    records = [
        synthesise_chunk(
            m, signed_distance(m), np.array([[0.0, 0.0, 1.0]]), [3, k, 0, 0], draws=200, max_trials=8
        )
        for k, m in enumerate(models)
    ]
    assert all(len(r) >= 2 for r in records)
    stage_one = GraspDataset(
        objects=models,
        first=np.cumsum([0, *(len(r) for r in records)]),
        position=np.concatenate([r.position for r in records]),
        rotation=np.concatenate([r.rotation for r in records]),
        joints=np.concatenate([r.joints for r in records]),
        fingers=np.concatenate([r.fingers for r in records]),
        uniform=np.concatenate([r.uniform for r in records]),
        scenes=[],
        drawn=np.array([r.drawn for r in records]),
        trials=np.array([r.trials for r in records]),
    )
    save_dataset(path, generate_scenes(stage_one, 3, 0, Engine(1), area=(0.5, 0.5)))
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="dgs_small_dataset_")


def small_dataset() -> GraspDataset:
    """The dataset as it is read from the file."""
    return load_dataset(small_dataset_file())

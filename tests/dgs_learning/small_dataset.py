"""A small real dataset, made once per test run: two objects, grasps from the simulation, scenes that settled."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from dgs_learning.dataset import GraspDataset, load_dataset, save_dataset
from dgs_learning.objects import shapes
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.generate import generate_scenes, packed
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
    found = [
        synthesise_chunk(
            m, signed_distance(m), np.array([[0.0, 0.0, 1.0]]), [3, k, 0, 0], draws=200, max_trials=8
        )
        for k, m in enumerate(models)
    ]
    assert all(len(each.grasps) >= 2 for each in found)
    stage_one = packed(models, found)
    save_dataset(path, generate_scenes(stage_one, 3, 0, Engine(1), area=(0.5, 0.5)))
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="dgs_small_dataset_")


def small_dataset() -> GraspDataset:
    """The dataset as it is read from the file."""
    return load_dataset(small_dataset_file())

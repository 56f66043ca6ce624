"""A small real dataset, made once per test run: two objects and grasps of the shipped file, scenes that settled."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from dgs_description.grasp import joined
from dgs_learning import paths
from dgs_learning.dataset import GraspDataset, load_dataset, save_dataset
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.generate import generate_scenes

NAMES = ("block_043@1.10", "can_056@1.00")
GRASPS = 7
"""Of each."""


@cache
def small_dataset_file() -> Path:
    """Path of the file; the folder lives as long as the process."""
    path = Path(_folder().name) / "small.npz"
    shipped = load_dataset(paths.dataset_file())
    numbers = [[model.name for model in shipped.objects].index(name) for name in NAMES]
    rows = np.concatenate([shipped.first[k] + np.arange(GRASPS) for k in numbers])
    small = replace(
        shipped,
        objects=[shipped.objects[k] for k in numbers],
        first=GRASPS * np.arange(len(NAMES) + 1),
        grasps=joined([shipped.own(k)[np.arange(GRASPS)] for k in numbers]),
        friction=shipped.friction[rows],
        gap=shipped.gap[rows],
        scenes=[],
        drawn=shipped.drawn[numbers],
        trials=shipped.trials[numbers],
    )
    save_dataset(path, generate_scenes(small, 3, 0, Engine(1)))
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="dgs_small_dataset_")


def small_dataset() -> GraspDataset:
    """The dataset as it is read from the file."""
    return load_dataset(small_dataset_file())

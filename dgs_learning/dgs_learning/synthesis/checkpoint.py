"""Keeps what is done, chunk by chunk and scene by scene, so that a killed run loses only the one under way.

A chunk, not a trial, is the unit: the trials of a chunk share one world, whose state (contact caches) outlives each
trial, so a chunk that goes on in a new world would give other grasps than one that ran through.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from dgs_learning.dataset import GraspDataset, SceneGrasps
from dgs_learning.synthesis.stage_one import GraspRecords


def save_records(path: Path, records: GraspRecords) -> None:
    """Write atomically: a killed run leaves either the whole file or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial.npz")
    np.savez_compressed(partial, allow_pickle=False, **vars(records))
    partial.replace(path)


def load_records(path: Path) -> GraspRecords:
    """Read what `save_records` wrote."""
    with np.load(path, allow_pickle=False) as data:
        scalars = {"drawn": int, "trials": int, "seconds": float}
        return GraspRecords(**{k: scalars[k](data[k]) if k in scalars else data[k] for k in data.files})


@dataclass(frozen=True)
class ChunkFolder:
    """Finished chunks of one object, one file each, named by all that decides their grasps.

    Attributes:
        path: the object's own folder; it appears with the first chunk.
    """

    path: Path

    def _file(self, key: Sequence[int], draws: int, trials: int) -> Path:
        return self.path / f"{'-'.join(str(k) for k in key)}_draws{draws}_trials{trials}.npz"

    def load(self, key: Sequence[int], draws: int, trials: int) -> GraspRecords | None:
        """The chunk of seed `key` with so many draws and at most so many trials, if it is done."""
        file = self._file(key, draws, trials)
        return load_records(file) if file.exists() else None

    def save(self, key: Sequence[int], draws: int, trials: int, records: GraspRecords) -> None:
        """Keep a finished chunk."""
        save_records(self._file(key, draws, trials), records)

    def clear(self) -> None:
        """Forget all chunks: the object is done."""
        shutil.rmtree(self.path, ignore_errors=True)


@dataclass(frozen=True)
class SceneFolder:
    """Finished scenes of one stage-2 run, one file each.

    Attributes:
        path: named after the grasps and settings that decide the scenes, so that those of others are never mixed in.
    """

    path: Path

    @classmethod
    def of(cls, folder: Path, dataset: GraspDataset, settings: Sequence[int], area: Sequence[float]) -> Self:
        """The folder of these stage-1 grasps and settings."""
        digest = hashlib.sha256(
            repr((list(settings), list(area), [o.name for o in dataset.objects])).encode()
        )
        for values in (dataset.first, dataset.position, dataset.rotation, dataset.joints, dataset.fingers):
            digest.update(np.ascontiguousarray(values).tobytes())
        return cls(folder / digest.hexdigest()[:16])

    def _file(self, number: int) -> Path:
        return self.path / f"scene_{number:04d}.npz"

    def has(self, number: int) -> bool:
        """Whether the scene is done."""
        return self._file(number).exists()

    def load(self, number: int) -> SceneGrasps | None:
        """A finished scene; None = fewer than two objects came to rest in it."""
        with np.load(self._file(number), allow_pickle=False) as data:
            return SceneGrasps(**{name: data[name] for name in data.files}) if data.files else None

    def save(self, number: int, scene: SceneGrasps | None) -> None:
        """Keep a finished scene."""
        self.path.mkdir(parents=True, exist_ok=True)
        partial = self._file(number).with_suffix(".partial.npz")
        np.savez_compressed(partial, allow_pickle=False, **(vars(scene) if scene else {}))
        partial.replace(self._file(number))

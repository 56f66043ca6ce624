"""Training samples: augmented views, their labels, and the batches that the network takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.utils.data import Dataset

from dgs_description.frames import apply, inverse, transform
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.network import NetworkConfig, VoxelBatch, collate, input_features
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_learning.training.labels import label
from dgs_learning.training.views import View, ViewSource

SHIFT, DROP, HEIGHT = 0.05, 0.3, 0.002
"""Augmentation: sideways shift of the scene [m], up to which share of the points is dropped, error of the table's
height [m]."""


@dataclass(frozen=True)
class Sample:
    """One view; its feasible grasps in the table frame, the object (G,) of each and its fingers (G, F) in the air."""

    view: View
    grasps: GraspSet
    owner: NDArray
    in_air: NDArray[np.bool_]
    seed: tuple[int, ...]


@dataclass(frozen=True)
class TrainingBatch:
    """A batch of clouds and the labels of all its voxels (rows of `Labels`, shifted to the batch's rows)."""

    voxels: VoxelBatch
    kind: Tensor
    worth: Tensor
    voxel: Tensor
    weight: Tensor
    rotation: Tensor
    offset: Tensor
    j_init: Tensor
    j_end: Tensor
    touch: Tensor
    chosen: Tensor

    def to(self, device: torch.device | str, non_blocking: bool = False) -> TrainingBatch:
        """The batch on another device."""
        return TrainingBatch(**{k: v.to(device, non_blocking=non_blocking) for k, v in vars(self).items()})

    def pin_memory(self) -> TrainingBatch:
        """The batch in page-locked memory; called by the DataLoader."""
        return TrainingBatch(**{k: v.pin_memory() for k, v in vars(self).items()})


def augment(view: View, grasps: GraspSet, rng: np.random.Generator) -> tuple[View, GraspSet]:
    """Turn, shift and thin out a view, and carry its grasps along, which stay valid."""
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    move = np.array([*rng.uniform(-SHIFT, SHIFT, 2), rng.normal(0.0, HEIGHT / 2)])
    keep = rng.random(len(view.points)) >= rng.uniform(0.0, DROP)
    points = (view.points[keep] @ turn.T + move).astype(np.float32)
    moved = View(points, view.instance[keep], view.camera @ turn.T + move)
    return moved, grasps.moved(transform(turn, move))


class ViewDataset(Dataset):
    """Samples (scene, view, epoch) by number; a sample depends on its key alone, whoever loads it."""

    def __init__(self, source: ViewSource, seed: int, augmented: bool):
        self.source, self.seed, self.augmented = source, seed, augmented

    def __getitem__(self, key: tuple[int, int, int]) -> Sample:
        """The sample of a (scene, view, epoch) key."""
        scene, number, epoch = key
        # Made anew each time: about a millisecond, where a thousand scenes kept by every worker would take gigabytes.
        dataset = self.source.dataset
        stored = dataset.scenes[scene]
        grasps, in_air = dataset.scene_grasps(stored), dataset.in_air[dataset.rows(stored)]
        view = self.source.view(scene, number)
        seed = (self.seed, scene, number, epoch)
        if self.augmented:
            view, grasps = augment(view, grasps, np.random.default_rng([*seed, 0]))
        return Sample(view, grasps, stored.instance, in_air, seed)


def _in_input_frame(sample: Sample, frame: str) -> Sample:
    """The sample as the network sees it when it is used."""
    T_input_table = inverse(table_from_input(frame, sample.view.camera))
    points = apply(T_input_table, sample.view.points.astype(float)).astype(np.float32)
    view = replace(sample.view, points=points, camera=apply(T_input_table, sample.view.camera))
    return replace(sample, view=view, grasps=sample.grasps.moved(T_input_table))


def make_batch(samples: Sequence[Sample], config: NetworkConfig, with_pairs: bool = True) -> TrainingBatch:
    """The batch of some samples; the paper's network gets the paper's frame and labels."""
    if config.frame != "table":
        samples = [_in_input_frame(sample, config.frame) for sample in samples]
    points = [torch.from_numpy(np.ascontiguousarray(s.view.points)) for s in samples]
    cameras = [torch.tensor(s.view.camera, dtype=torch.float32) for s in samples]
    features = [input_features(p, c, config) for p, c in zip(points, cameras, strict=True)]
    voxels = collate(points, features, config, with_pairs=with_pairs)
    instance = np.full(len(voxels.centres), -1, dtype=np.int64)
    instance[voxels.point_voxel.numpy()] = np.concatenate([s.view.instance for s in samples])
    centres = voxels.centres.numpy().astype(np.float64)
    columns: dict[str, list[NDArray]] = {f.name: [] for f in fields(TrainingBatch) if f.name != "voxels"}
    start = pairs = 0
    for sample, count in zip(samples, voxels.voxel_counts, strict=True):
        own = slice(start, start + count)
        rng = np.random.default_rng([*sample.seed, 1])
        grasps, paper = (sample.grasps, sample.owner), config.name == "paper"
        found = label(centres[own], instance[own], *grasps, rng, paper, sample.in_air)
        shift = {"voxel": start, "chosen": pairs}
        for name, column in columns.items():
            column.append(getattr(found, name) + shift[name] if name in shift else getattr(found, name))
        start, pairs = start + count, pairs + len(found.voxel)
    joined = {name: torch.from_numpy(np.concatenate(column)) for name, column in columns.items()}
    return TrainingBatch(voxels, **joined)

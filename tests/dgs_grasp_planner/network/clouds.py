"""Batches for the tests of the network."""

from __future__ import annotations

import torch
from torch import Tensor

from dgs_grasp_planner.network import NetworkConfig, VoxelBatch, collate, input_features
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene


def cloud(count: int, seed: int = 0) -> Tensor:
    """(count, 3) points of a scene in the table frame."""
    points = torch.from_numpy(table_scene(seed))
    chosen = torch.randperm(len(points), generator=torch.Generator().manual_seed(seed))[:count]
    return points[chosen]


def batch_of(clouds: list[Tensor], config: NetworkConfig, with_pairs: bool = True) -> VoxelBatch:
    """The clouds as the network takes them."""
    camera = torch.from_numpy(CAMERA).float()
    return collate(clouds, [input_features(c, camera, config) for c in clouds], config, with_pairs)

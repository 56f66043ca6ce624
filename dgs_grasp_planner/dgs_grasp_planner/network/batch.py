"""From point clouds to the network's input: point features, and the batch of voxels with all its tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import torch
from torch import Tensor

from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.geometry import Level, build_levels
from dgs_grasp_planner.network.voxels import voxelise

XYZ_SCALE = 0.2
HEIGHT_SCALE = 0.1
"""Metres that one unit of the features `xyz` and `height` stands for."""


def input_features(points: Tensor, camera_position: Tensor, config: NetworkConfig) -> Tensor:
    """Features per point, all of order one, in the order of `config.point_features`.

    `ones`: 1, marks occupied voxels for the stem. `height`: z above the table. `xyz`: coordinates in the input frame.
    `ray`: unit vector from the camera to the point.

    Args:
        points: (N, 3) [m] in the input frame.
        camera_position: (3,) [m] in the input frame.

    Returns:
        (N, F) float tensor.
    """
    columns = []
    for name in config.point_features:
        if name == "ones":
            columns.append(torch.ones_like(points[:, :1]))
        elif name == "height":
            columns.append(points[:, 2:] / HEIGHT_SCALE)
        elif name == "xyz":
            columns.append(points / XYZ_SCALE)
        else:
            columns.append(torch.nn.functional.normalize(points - camera_position.to(points), dim=1))
    return torch.cat(columns, 1) if columns else points.new_zeros(points.shape[0], 0)


def _map_tensors(value: Any, function: Callable[[Tensor], Tensor]) -> Any:
    """The same nest of dataclasses and tuples with `function` applied to every tensor."""
    if isinstance(value, Tensor):
        return function(value)
    if isinstance(value, tuple):
        return tuple(_map_tensors(item, function) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        changed = {f.name: _map_tensors(getattr(value, f.name), function) for f in fields(value)}
        return replace(value, **changed)
    return value


@dataclass(frozen=True)
class VoxelBatch:
    """A batch of clouds as the network takes it: V voxels, N points, B clouds.

    Attributes:
        centres: (V, 3) mean of the points of every voxel [m], input frame.
        features: (V, F) input features.
        cloud: (V,) int64 index of the cloud.
        point_voxel: (N,) int64 voxel row of every point, points in the order they were given.
        voxel_counts: voxels per cloud (B integers); a cloud's voxels stand together.
        levels: tables per resolution.
    """

    centres: Tensor
    features: Tensor
    cloud: Tensor
    point_voxel: Tensor
    voxel_counts: tuple[int, ...]
    levels: tuple[Level, ...]

    def to(
        self, device: torch.device | str, dtype: torch.dtype | None = None, non_blocking: bool = False
    ) -> VoxelBatch:
        """The batch on another device, its features optionally as another type. On a GPU the pair lists stay behind."""
        device = torch.device(device)
        batch = self
        if device.type != "cpu":
            batch = replace(self, levels=tuple(replace(level, pairs=None) for level in self.levels))
        moved: VoxelBatch = _map_tensors(batch, lambda t: t.to(device, non_blocking=non_blocking))
        return moved if dtype is None else replace(moved, features=moved.features.to(dtype))

    def pin_memory(self) -> VoxelBatch:
        """The batch in page-locked memory, for a DataLoader's `pin_memory`."""
        return _map_tensors(self, lambda t: t.pin_memory())


def collate(
    points: Sequence[Tensor], features: Sequence[Tensor], config: NetworkConfig, with_pairs: bool = True
) -> VoxelBatch:
    """Voxelise a batch of clouds and build all tables.

    Args:
        points: per cloud (N_i, 3) float32 [m] in the input frame, all finite, at least one each.
        features: per cloud (N_i, F) from `input_features`.
        with_pairs: build the pair lists; not needed if the batch goes to a GPU.

    Raises:
        DgsError: CLOUD_FORMAT: a cloud extends too far.
    """
    xyz, values = torch.cat(list(points)), torch.cat(list(features))
    lengths = torch.tensor([len(p) for p in points], device=xyz.device)
    cloud = torch.repeat_interleave(torch.arange(len(points), device=xyz.device), lengths)
    size = config.voxel_size
    voxels = voxelise(xyz, cloud, len(points), size, config.grid_bits, config.levels, config.orders)
    mean = voxels.mean(torch.cat([xyz, values.to(xyz.dtype)], 1))
    centres, averaged = mean[:, :3], mean[:, 3:]
    if "residual" in config.features:
        residual = centres / size - (voxels.lattice.to(xyz.dtype) + 0.5)
        averaged = torch.cat([averaged, residual], 1)
    levels = build_levels(
        voxels.grid, voxels.cloud, voxels.codes, len(points), config.levels, config.patch_size, with_pairs
    )
    counts = tuple(torch.bincount(voxels.cloud, minlength=len(points)).tolist())
    return VoxelBatch(centres, averaged, voxels.cloud, voxels.point_voxel, counts, levels)

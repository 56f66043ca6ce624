"""From point clouds to the network's input: point features, and the batch of voxels with all its tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from dgs_description.errors import DgsError, ErrorCode
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
    columns = {
        "ones": torch.ones_like(points[:, :1]),
        "height": points[:, 2:] / HEIGHT_SCALE,
        "xyz": points / XYZ_SCALE,
        "ray": F.normalize(points - camera_position.to(points), dim=1),
    }
    return torch.cat([points[:, :0], *(columns[name] for name in config.point_features)], 1)


class VoxelBatch(NamedTuple):
    """A batch of clouds as the network takes it: V voxels, N points, B clouds.

    Attributes:
        centres: (V, 3) mean of the points of every voxel [m], input frame.
        features: (V, F) input features.
        point_voxel: (N,) int64 voxel row of every point, points in the order they were given.
        voxel_counts: voxels per cloud (B integers); a cloud's voxels stand together.
        levels: tables per resolution.
    """

    centres: Tensor
    features: Tensor
    point_voxel: Tensor
    voxel_counts: tuple[int, ...]
    levels: tuple[Level, ...]


def to_device(value: Any, device: torch.device | str, non_blocking: bool = False) -> Any:
    """The same nest of (named) tuples, a `VoxelBatch` for example, with all its tensors on a device."""
    if isinstance(value, Tensor):
        return value.to(device, non_blocking=non_blocking)
    if not isinstance(value, tuple):
        return value
    items = [to_device(item, device, non_blocking) for item in value]
    return type(value)(*items) if hasattr(value, "_fields") else tuple(items)


def collate(points: Sequence[Tensor], features: Sequence[Tensor], config: NetworkConfig) -> VoxelBatch:
    """Voxelise a batch of clouds and build all tables.

    Args:
        points: per cloud (N_i, 3) float32 [m] in the input frame.
        features: per cloud (N_i, F) from `input_features`.
        config: voxel size, levels, curves and patch size.

    Raises:
        DgsError: CLOUD_EMPTY, CLOUD_NOT_FINITE, or CLOUD_FORMAT (shapes, extent).
    """
    if not points or any(p.shape[0] == 0 for p in points):
        raise DgsError(ErrorCode.CLOUD_EMPTY, "a cloud of the batch has no points")
    if any(
        p.ndim != 2 or p.shape[1] != 3 or f.shape[0] != p.shape[0]
        for p, f in zip(points, features, strict=True)
    ):
        raise DgsError(ErrorCode.CLOUD_FORMAT, "points must be (N, 3) with one row of features each")
    xyz, values = torch.cat(list(points)), torch.cat(list(features))
    if not bool(torch.isfinite(xyz).all()):
        raise DgsError(ErrorCode.CLOUD_NOT_FINITE, "a cloud of the batch holds NaN or infinity")
    clouds, size = len(points), config.voxel_size
    lengths = torch.tensor([p.shape[0] for p in points], device=xyz.device)
    cloud = torch.repeat_interleave(torch.arange(clouds, device=xyz.device), lengths)
    voxels = voxelise(xyz, cloud, clouds, size, config.grid_bits, config.levels, config.orders)
    mean = voxels.mean(torch.cat([xyz, values.to(xyz.dtype)], 1))
    centres, averaged = mean[:, :3], mean[:, 3:]
    if "residual" in config.features:
        residual = centres / size - (voxels.lattice.to(xyz.dtype) + 0.5)
        averaged = torch.cat([averaged, residual], 1)
    levels = build_levels(voxels.grid, voxels.cloud, voxels.codes, clouds, config.levels, config.patch_size)
    counts = tuple(torch.bincount(voxels.cloud, minlength=clouds).tolist())
    return VoxelBatch(centres, averaged, voxels.point_voxel, counts, levels)

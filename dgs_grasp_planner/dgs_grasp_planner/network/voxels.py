"""Voxels of a batch of clouds, and their places along space-filling curves. Integer work in PyTorch, on CPU and GPU."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from dgs_description.errors import DgsError, ErrorCode


def _spread3(v: Tensor) -> Tensor:
    """Put two zero bits before each of the lowest 16 bits of v (int64)."""
    v = v & 0xFFFF
    v = (v | (v << 16)) & 0x0000FF0000FF
    v = (v | (v << 8)) & 0x00F00F00F00F
    v = (v | (v << 4)) & 0x0C30C30C30C3
    return (v | (v << 2)) & 0x249249249249


def z_code(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Morton index of non-negative integer coordinates (N,), int64."""
    return (_spread3(x) << 2) | (_spread3(y) << 1) | _spread3(z)


def hilbert_code(x: Tensor, y: Tensor, z: Tensor, bits: int) -> Tensor:
    """Hilbert index of coordinates (N,) below 2^bits, int64.

    The axes-to-transpose recurrence of J. Skilling, "Programming the Hilbert curve" (2004), without branches.
    """
    a, b, c = x, y, z
    for bit in range(bits - 1, 0, -1):
        low = (1 << bit) - 1
        a = a ^ (-((a >> bit) & 1) & low)
        for second in (True, False):
            axis = b if second else c
            is_set = -((axis >> bit) & 1)
            swap = (a ^ axis) & low & ~is_set
            a = a ^ (is_set & low) ^ swap
            axis = axis ^ swap
            b, c = (axis, c) if second else (b, axis)
    b = b ^ a
    c = c ^ b
    flip = torch.zeros_like(x)
    for bit in range(bits - 1, 0, -1):
        flip = flip ^ (-((c >> bit) & 1) & ((1 << bit) - 1))
    return z_code(a ^ flip, b ^ flip, c ^ flip)


def curve_codes(grid: Tensor, cloud: Tensor, orders: tuple[str, ...], bits: int) -> Tensor:
    """Place of every voxel along several curves; clouds stay apart.

    Args:
        grid: (V, 3) int64 coordinates in [0, 2^bits).
        cloud: (V,) int64 index of the cloud.
        orders: curves `h`, `ht`, `z`, `zt` (t = x and y exchanged).

    Returns:
        (len(orders), V) int64; dropping the last 3 bits gives the code of the parent voxel.
    """
    n = grid.shape[0]
    x, y, z = grid.unbind(1)
    xx, yy, zz = torch.cat([x, y]), torch.cat([y, x]), torch.cat([z, z])
    codes = {}
    if any(order[0] == "h" for order in orders):
        code = hilbert_code(xx, yy, zz, bits)
        codes["h"], codes["ht"] = code[:n], code[n:]
    if any(order[0] == "z" for order in orders):
        code = z_code(xx, yy, zz)
        codes["z"], codes["zt"] = code[:n], code[n:]
    return torch.stack([codes[order] for order in orders]) | (cloud << (3 * bits))


@dataclass(frozen=True)
class Voxels:
    """Occupied voxels of a batch, sorted by cloud and the first curve.

    Attributes:
        grid: (V, 3) int64 coordinates, not negative.
        cloud: (V,) int64 index of the cloud.
        codes: (orders, V) int64, see `curve_codes`.
        point_voxel: (N,) int64 row of the voxel that every point fell into.
        count: (V,) int64 points per voxel.
        lattice: (V, 3) int64 coordinates in the input frame: voxel centre = (lattice + 0.5) * size.
    """

    grid: Tensor
    cloud: Tensor
    codes: Tensor
    point_voxel: Tensor
    count: Tensor
    lattice: Tensor

    def mean(self, values: Tensor) -> Tensor:
        """(V, C) mean over the points of every voxel of (N, C) values."""
        total = values.new_zeros(self.count.shape[0], values.shape[1]).index_add_(0, self.point_voxel, values)
        return total / self.count[:, None].to(values.dtype)


def voxelise(
    points: Tensor, cloud: Tensor, clouds: int, size: float, bits: int, levels: int, orders: tuple[str, ...]
) -> Voxels:
    """Sort the points of a batch into voxels.

    The lattice is fixed in the input frame, also at the coarser levels, and every cloud has its own origin (a multiple
    of the coarsest voxel), so that a cloud's voxels do not depend on its company in the batch.

    Args:
        points: (N, 3) [m], finite.
        cloud: (N,) int64 index of the cloud of every point, each of 0..clouds-1 used.
        size: edge of a voxel [m].
        bits: bits per axis.
        levels: number of resolutions, each half the one before.
        orders: curves; the voxels are sorted by the first one.

    Raises:
        DgsError: CLOUD_FORMAT if a cloud extends over 2^bits voxels or more.
    """
    lattice = torch.floor(points / size).to(torch.int64)
    lowest = torch.full((clouds, 3), 1 << 40, dtype=torch.int64, device=points.device)
    lowest.scatter_reduce_(0, cloud[:, None].expand(-1, 3), lattice, "amin")
    origin = (lowest >> (levels - 1)) << (levels - 1)
    grid = lattice - origin[cloud]
    if int(grid.amax()) >= 1 << bits:
        raise DgsError(
            ErrorCode.CLOUD_FORMAT,
            f"the cloud extends over {int(grid.amax()) * size:.2f} m, {(1 << bits) * size:.2f} m are possible: crop it",
        )
    key = (((cloud << bits | grid[:, 0]) << bits) | grid[:, 1]) << bits | grid[:, 2]
    unique, point_voxel, count = torch.unique(key, return_inverse=True, return_counts=True)
    mask = (1 << bits) - 1
    grid = torch.stack([unique >> (2 * bits) & mask, unique >> bits & mask, unique & mask], 1)
    cloud = unique >> (3 * bits)
    codes = curve_codes(grid, cloud, orders, bits)
    order = torch.argsort(codes[0])
    rank = torch.empty_like(order)
    rank[order] = torch.arange(order.shape[0], device=order.device)
    grid, cloud = grid[order], cloud[order]
    return Voxels(grid, cloud, codes[:, order], rank[point_voxel], count[order], grid + origin[cloud])

"""Everything integer, once per cloud: neighbour tables, attention patches and pooling maps of all levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

DENSE_VOLUME_LIMIT = 1 << 26
"""Cells of the lookup volume up to which it is used (256 MB); it is about 12 times as fast as a search."""


class Patches(NamedTuple):
    """Windows of `size` rows along one curve, P of them.

    Attributes:
        gather: (P * size,) int64 rows in patch order.
        back: (V,) int64 place of every row in patch order.
        size: rows per window.
        mask: (P, size) bool, False where a cloud has fewer rows than the window; None if there is no such place.
    """

    gather: Tensor
    back: Tensor
    size: int
    mask: Tensor | None


class Level(NamedTuple):
    """One resolution of a batch of clouds with V occupied voxels.

    Attributes:
        neighbours: (V, 27) int32 rows of the 3x3x3 neighbourhood, V where empty. Offsets k and 26 - k are opposite.
        patches: one per curve.
        parent: (V,) int64 row in the next level.
        children: (V_next,) int64 how many rows of this level, one after the other, share a parent.
    """

    neighbours: Tensor
    patches: tuple[Patches, ...]
    parent: Tensor
    children: Tensor

    @property
    def rows(self) -> int:
        """Number of occupied voxels."""
        return int(self.neighbours.shape[0])


def kernel_offsets() -> Tensor:
    """(27, 3) int64 offsets of a 3x3x3 kernel, x slowest."""
    r = torch.arange(-1, 2)
    return torch.cartesian_prod(r, r, r)


def neighbour_table(grid: Tensor, cloud: Tensor, clouds: int) -> Tensor:
    """(V, 27) int32 rows of the 3x3x3 neighbours of every voxel of the same cloud, V where there is none.

    Args:
        grid: (V, 3) int64 coordinates, not negative, unique per cloud.
        cloud: (V,) int64 index of the cloud.
        clouds: number of clouds.
    """
    n, device = grid.shape[0], grid.device
    # A margin of one cell on every side: no neighbour's key is that of a voxel elsewhere.
    size_x, size_y, size_z = (int(v) + 3 for v in grid.amax(0).tolist())
    strides = torch.tensor([size_y * size_z, size_z, 1], device=device)
    key = cloud * (size_x * size_y * size_z) + ((grid + 1) * strides).sum(1)
    wanted = key[:, None] + (kernel_offsets().to(device) * strides).sum(1)
    cells = clouds * size_x * size_y * size_z
    if cells <= DENSE_VOLUME_LIMIT:
        row_of_cell = torch.full((cells,), n, dtype=torch.int32, device=device)
        row_of_cell[key] = torch.arange(n, dtype=torch.int32, device=device)
        return row_of_cell[wanted]
    ordered, permutation = torch.sort(key)
    place = torch.searchsorted(ordered, wanted).clamp_(max=n - 1)
    return torch.where(ordered[place] == wanted, permutation[place], n).to(torch.int32)


def make_patches(orders: Sequence[Tensor], counts: list[int], size: int) -> tuple[Patches, ...]:
    """Cut every cloud's list along each curve into windows of equal size; the last window overlaps the one before.

    A cloud shorter than the window repeats its last row, masked. So a cloud's windows never depend on the other clouds.

    Args:
        orders: per curve (V,) int64 rows along it, clouds one after the other.
        counts: rows per cloud.
        size: rows per window.
    """
    device = orders[0].device
    size = min(size, max(counts))
    index, place, masks = [], [], []
    base = windows_before = 0
    for count in counts:  # a few clouds per batch
        windows = -(-count // size)
        start = torch.arange(windows, device=device) * size
        start[-1] = max(count - size, 0)
        inside = start[:, None] + torch.arange(size, device=device)[None]
        index.append(inside.clamp(max=count - 1).reshape(-1) + base)
        masks.append(inside < count)
        rows = torch.arange(count, device=device)
        window = rows // size
        place.append((windows_before + window) * size + rows - start[window])
        base += count
        windows_before += windows
    all_index, all_places = torch.cat(index), torch.cat(place)
    mask = torch.cat(masks) if min(counts) < size else None
    out = []
    for order in orders:
        back = torch.empty_like(order)
        back[order] = all_places
        out.append(Patches(order[all_index], back, size, mask))
    return tuple(out)


def build_levels(
    grid: Tensor, cloud: Tensor, codes: Tensor, clouds: int, levels: int, patch_size: int
) -> tuple[Level, ...]:
    """Tables of all resolutions.

    Args:
        grid: (V, 3) int64 coordinates; rows sorted by `codes[0]`.
        cloud: (V,) int64 index of the cloud.
        codes: (orders, V) int64 places along the curves.
        clouds: number of clouds.
        levels: number of resolutions.
        patch_size: rows per attention window.
    """
    out = []
    for _ in range(levels):
        neighbours = neighbour_table(grid, cloud, clouds)
        orders = [torch.arange(grid.shape[0], device=grid.device), *torch.argsort(codes[1:], dim=1)]
        patches = make_patches(orders, torch.bincount(cloud, minlength=clouds).tolist(), patch_size)
        codes = codes >> 3
        # Rows are sorted by the first curve, so children of one parent stand next to each other.
        _, parent, children = torch.unique_consecutive(codes[0], return_inverse=True, return_counts=True)
        out.append(Level(neighbours, patches, parent, children))
        first = children.cumsum(0) - children
        grid, cloud, codes = grid[first] >> 1, cloud[first], codes[:, first]
    return tuple(out)

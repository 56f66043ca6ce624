"""Everything integer, once per cloud: neighbour tables, pair lists, attention patches, pooling maps of all levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

DENSE_VOLUME_LIMIT = 1 << 26
"""Cells of a lookup volume up to which it beats the search in sorted keys."""


@dataclass(frozen=True)
class PairList:
    """The occupied (destination, source) pairs of a neighbour table, grouped by kernel offset.

    Attributes:
        source, destination: (P,) int32 rows.
        count: 27 integers, pairs per offset.
        order: (P,) int32, the pairs regrouped by destination.
        start: (V + 1,) int32, where a destination's pairs begin in `order`.
    """

    source: Tensor
    destination: Tensor
    count: tuple[int, ...]
    order: Tensor
    start: Tensor


@dataclass(frozen=True)
class Patches:
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


@dataclass(frozen=True)
class Level:
    """One resolution of a batch of clouds with V occupied voxels.

    Attributes:
        neighbours: (V, 27) int32 rows of the 3x3x3 neighbourhood, V where empty. Offsets k and 26 - k are opposite.
        pairs: the same as a list, for the CPU; None on a GPU.
        patches: one per curve.
        parent: (V,) int64 row in the next level; None at the coarsest.
        child: (V_next, 8) int64 rows of this level, the first child repeated; None at the coarsest.
    """

    neighbours: Tensor
    pairs: PairList | None
    patches: tuple[Patches, ...]
    parent: Tensor | None
    child: Tensor | None

    @property
    def rows(self) -> int:
        """Number of occupied voxels."""
        return int(self.neighbours.shape[0])


def kernel_offsets() -> Tensor:
    """(27, 3) int64 offsets of a 3x3x3 kernel, x slowest."""
    r = torch.arange(-1, 2)
    return torch.stack(torch.meshgrid(r, r, r, indexing="ij"), -1).reshape(-1, 3)


def _linear_keys(grid: Tensor, cloud: Tensor) -> tuple[Tensor, Tensor, int]:
    """Keys (V,) with a margin of one cell, their differences (27,) to the neighbours, and the volume of one cloud."""
    _, size_y, size_z = (int(v) + 3 for v in grid.amax(0).tolist())
    volume = (int(grid[:, 0].amax()) + 3) * size_y * size_z
    key = cloud * volume + ((grid[:, 0] + 1) * size_y + grid[:, 1] + 1) * size_z + grid[:, 2] + 1
    offsets = kernel_offsets().to(grid.device)
    return key, (offsets[:, 0] * size_y + offsets[:, 1]) * size_z + offsets[:, 2], volume


def neighbours_by_volume(grid: Tensor, cloud: Tensor, clouds: int) -> Tensor:
    """(V, 27) int32 neighbour table through a dense lookup volume."""
    n = grid.shape[0]
    key, difference, volume = _linear_keys(grid, cloud)
    lookup = torch.full((clouds * volume,), n, dtype=torch.int32, device=grid.device)
    lookup[key] = torch.arange(n, dtype=torch.int32, device=grid.device)
    return lookup[key[:, None] + difference]


def neighbours_by_search(grid: Tensor, cloud: Tensor) -> Tensor:
    """The same table by binary search in the sorted keys, for clouds whose volume is too large to write down."""
    n = grid.shape[0]
    key, difference, _ = _linear_keys(grid, cloud)
    ordered, permutation = torch.sort(key)
    wanted = ordered[None] + difference[:, None]
    place = torch.searchsorted(ordered, wanted.reshape(-1)).view(27, n).clamp_(max=n - 1)
    found = torch.where(ordered[place] == wanted, permutation[place], n)
    table = torch.empty(n, 27, dtype=torch.int32, device=grid.device)
    table[permutation] = found.t().to(torch.int32)
    return table


def neighbour_table(grid: Tensor, cloud: Tensor, clouds: int) -> Tensor:
    """(V, 27) int32 rows of the 3x3x3 neighbours of every voxel of the same cloud, V where there is none.

    Args:
        grid: (V, 3) int64 coordinates, not negative, unique per cloud.
        cloud: (V,) int64 index of the cloud; a cloud's voxels stand together.
    """
    volume = 1
    for extent in grid.amax(0).tolist():
        volume *= int(extent) + 3
    if clouds * volume <= DENSE_VOLUME_LIMIT:
        return neighbours_by_volume(grid, cloud, clouds)
    if volume > DENSE_VOLUME_LIMIT:
        return neighbours_by_search(grid, cloud)
    tables, first, rows = [], 0, grid.shape[0]
    for count in torch.bincount(cloud, minlength=clouds).tolist():
        own = slice(first, first + count)
        table = neighbours_by_volume(grid[own], torch.zeros_like(cloud[own]), 1)
        tables.append(torch.where(table == count, rows, table + first).to(torch.int32))
        first += count
    return torch.cat(tables)


def _places(flags: Tensor) -> Tensor:
    # numpy finds them several times as fast as torch's nonzero.
    return torch.from_numpy(np.flatnonzero(flags.numpy()))


def pair_list(neighbours: Tensor) -> PairList:
    """The occupied pairs of a (V, 27) neighbour table on the CPU. No sort is needed."""
    n = neighbours.shape[0]
    hit_by_row = neighbours < n
    hit = hit_by_row.t().contiguous()
    where = _places(hit)
    source = neighbours.t().reshape(-1).index_select(0, where)
    # Places in the list by offset and row, read row by row: they count on along every offset.
    rank = (hit.view(-1).cumsum(0, dtype=torch.int32) - 1).view(27, n)
    order = rank.t().reshape(-1).index_select(0, _places(hit_by_row))
    start = torch.zeros(n + 1, dtype=torch.int32, device=neighbours.device)
    start[1:] = hit_by_row.sum(1).cumsum(0)
    destination = (where % n).to(torch.int32)
    return PairList(source, destination, tuple(hit.sum(1).tolist()), order, start)


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
    grid: Tensor,
    cloud: Tensor,
    codes: Tensor,
    clouds: int,
    levels: int,
    patch_size: int,
    with_pairs: bool = True,
) -> tuple[Level, ...]:
    """Tables of all resolutions.

    Args:
        grid: (V, 3) int64 coordinates; rows sorted by `codes[0]`.
        cloud: (V,) int64 index of the cloud.
        codes: (orders, V) int64 places along the curves.
        patch_size: rows per attention window.
        with_pairs: build the pair lists (CPU).
    """
    out = []
    for depth in range(levels):
        rows = grid.shape[0]
        counts = torch.bincount(cloud, minlength=clouds).tolist()
        neighbours = neighbour_table(grid, cloud, clouds)
        straight = torch.arange(rows, device=grid.device)
        orders = [straight, *torch.argsort(codes[1:], dim=1)]
        patches = make_patches(orders, counts, patch_size)
        pairs = pair_list(neighbours) if with_pairs else None
        if depth + 1 == levels:
            out.append(Level(neighbours, pairs, patches, None, None))
            break
        codes = codes >> 3
        # Rows are sorted by the first curve, so children of one parent stand next to each other.
        head = torch.ones(rows, dtype=torch.bool, device=grid.device)
        head[1:] = codes[0, 1:] != codes[0, :-1]
        parent = torch.cumsum(head, 0) - 1
        first = head.nonzero().view(-1)
        child = first[:, None].repeat(1, 8)
        child[parent, straight - first[parent]] = straight
        out.append(Level(neighbours, pairs, patches, parent, child))
        grid, cloud, codes = grid[first] >> 1, cloud[first], codes[:, first]
    return tuple(out)

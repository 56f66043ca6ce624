"""Neighbour tables, pair lists, patches and pooling maps against plain Python."""

from __future__ import annotations

import pytest
import torch

from dgs_grasp_planner.network import PRESETS, geometry
from dgs_grasp_planner.network.geometry import (
    kernel_offsets,
    make_patches,
    neighbour_table,
    neighbours_by_volume,
    pair_list,
)
from tests.dgs_grasp_planner.network.clouds import batch_of, cloud


@pytest.fixture(scope="module")
def voxels() -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    grid = torch.randint(0, 7, (150, 3), generator=generator).unique(dim=0)
    index = torch.cat([torch.zeros(len(grid)), torch.ones(len(grid) - 20)]).long()
    return torch.cat([grid, grid[20:]]), index


def test_neighbour_table_against_a_dictionary(voxels: tuple[torch.Tensor, torch.Tensor]) -> None:
    grid, index = voxels
    table = neighbours_by_volume(grid, index, 2)
    rows = {(int(c), *xyz): row for row, (c, xyz) in enumerate(zip(index, grid.tolist(), strict=True))}
    for row in range(len(grid)):
        for k, offset in enumerate(kernel_offsets().tolist()):
            key = (int(index[row]), *(a + b for a, b in zip(grid[row].tolist(), offset, strict=True)))
            assert table[row, k] == rows.get(key, len(grid))


@pytest.mark.parametrize("limit", [0, 1000, 1 << 20])
def test_search_and_volumes_of_all_or_of_each_cloud_give_the_same_table(
    voxels: tuple[torch.Tensor, torch.Tensor], limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid, index = voxels
    monkeypatch.setattr(geometry, "DENSE_VOLUME_LIMIT", limit)
    found, expected = neighbour_table(grid, index, 2), neighbours_by_volume(grid, index, 2)
    assert found.dtype == torch.int32 and torch.equal(found, expected)


def test_pair_list_holds_every_occupied_pair(voxels: tuple[torch.Tensor, torch.Tensor]) -> None:
    table = neighbours_by_volume(*voxels, 2)
    pairs = pair_list(table)
    offset = torch.repeat_interleave(torch.arange(27), torch.tensor(pairs.count))
    listed = set(zip(pairs.destination.tolist(), offset.tolist(), pairs.source.tolist(), strict=True))
    there = {(row, k, int(s)) for row, line in enumerate(table) for k, s in enumerate(line) if s < len(table)}
    assert listed == there
    by_row = pairs.destination[pairs.order]
    assert torch.equal(by_row, by_row.sort().values)
    assert torch.equal(pairs.start.diff(), torch.bincount(pairs.destination, minlength=len(table)))


@pytest.mark.parametrize("counts", [[10, 3, 8], [4], [8, 9], [1, 20]])
def test_patches_stay_in_their_cloud_and_reach_every_row(counts: list[int]) -> None:
    total = sum(counts)
    start = [sum(counts[:i]) for i in range(len(counts))]
    orders = [
        torch.cat([torch.randperm(n) + s for n, s in zip(counts, start, strict=True)]) for _ in range(2)
    ]
    along_first, patches = make_patches(orders, counts, 8)
    assert torch.equal(along_first.gather[along_first.back], torch.arange(total))
    assert torch.equal(orders[1][orders[0].argsort()][along_first.gather], patches.gather), (
        "the same cut of each curve"
    )
    assert torch.equal(patches.gather[patches.back], torch.arange(total))
    owner = torch.repeat_interleave(torch.arange(len(counts)), torch.tensor(counts))
    windows = owner[patches.gather].view(-1, patches.size)
    assert torch.equal(windows, windows[:, :1].expand_as(windows))
    if patches.mask is not None:
        valid = patches.gather.view(-1, patches.size)[patches.mask]
        assert set(valid.tolist()) == set(range(total))
        for window, mask in zip(patches.gather.view(-1, patches.size), patches.mask, strict=True):
            assert len(set(window[mask].tolist())) == int(mask.sum()), "a row stands twice in its window"
    else:
        assert min(counts) >= patches.size


def test_children_and_parents_agree_at_every_level() -> None:
    batch = batch_of([cloud(900), cloud(400, 1)], PRESETS["fast"])
    for level, coarse in zip(batch.levels[:-1], batch.levels[1:], strict=True):
        assert level.parent is not None and level.child is not None
        assert level.child.shape == (coarse.rows, 8)
        for parent in range(coarse.rows):
            wanted = (level.parent == parent).nonzero().view(-1).tolist()
            assert sorted(set(level.child[parent].tolist())) == wanted

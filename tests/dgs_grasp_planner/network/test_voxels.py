"""Voxels and space-filling curves."""

from __future__ import annotations

import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.network.voxels import curve_codes, hilbert_code, voxelise, z_code
from tests.support.refused import refused


def _all_cells(bits: int) -> torch.Tensor:
    axis = torch.arange(1 << bits)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def test_hilbert_curve_visits_every_cell_once_and_steps_to_a_neighbour() -> None:
    cells = _all_cells(4)
    code = hilbert_code(*cells.unbind(1), bits=4)
    assert torch.equal(code.sort().values, torch.arange(len(cells)))
    path = cells[code.argsort()]
    assert torch.equal((path[1:] - path[:-1]).abs().sum(1), torch.ones(len(cells) - 1, dtype=torch.int64))


def test_z_code_interleaves_bits() -> None:
    code = z_code(torch.tensor([0b101]), torch.tensor([0b011]), torch.tensor([0b110]))
    # bits of x, y, z from the highest: (1,0,1), (0,1,1), (1,1,0)
    assert code.item() == 0b101_011_110


@pytest.mark.parametrize("order", ["h", "ht", "z", "zt"])
def test_dropping_three_bits_gives_the_parents_cell(order: str) -> None:
    cells = _all_cells(3)
    cloud = torch.zeros(len(cells), dtype=torch.int64)
    parent_of_code = curve_codes(cells, cloud, (order,), 3)[0] >> 3
    for value in parent_of_code.unique():
        siblings = cells[parent_of_code == value] >> 1
        assert len(siblings) == 8
        assert torch.equal(siblings, siblings[:1].expand(8, 3))


def test_voxels_hold_the_mean_of_their_points() -> None:
    points = torch.tensor(
        [[0.001, 0.001, 0.001], [0.003, 0.001, 0.001], [0.0101, 0.0, 0.0], [-0.001, 0.0, 0.0]]
    )
    voxels = voxelise(points, torch.zeros(4, dtype=torch.int64), 1, 0.005, 10, 3, ("h",))
    assert len(voxels.grid) == 3
    assert voxels.point_voxel[0] == voxels.point_voxel[1]
    mean = voxels.mean(points)
    torch.testing.assert_close(mean[voxels.point_voxel[0]], torch.tensor([0.002, 0.001, 0.001]))
    torch.testing.assert_close(mean[voxels.point_voxel[3]], points[3])
    assert voxels.lattice[voxels.point_voxel[3]].tolist() == [-1, 0, 0]
    assert (voxels.grid >= 0).all()


def test_a_cloud_that_is_too_wide_is_refused() -> None:
    points = torch.tensor([[0.0, 0.0, 0.0], [6.0, 0.0, 0.0]])
    with refused(ErrorCode.CLOUD_FORMAT) as error:
        voxelise(points, torch.zeros(2, dtype=torch.int64), 1, 0.005, 10, 5, ("h",))
    assert "6.0" in error.value.message

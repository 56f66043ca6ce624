"""Sparse convolution against torch's dense one, in both forms, and its gradients."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from dgs_grasp_planner.network import sparse_conv
from dgs_grasp_planner.network.geometry import Level, neighbour_table, pair_list
from dgs_grasp_planner.network.sparse_conv import CHUNK, SparseConvolution, tall_product


@pytest.fixture(params=["at once", "by offset"])
def gathered(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """How the rows of the 27 offsets are gathered: in one call as in small layers, or one after the other."""
    monkeypatch.setattr(sparse_conv, "AT_ONCE", 1 << 30 if request.param == "at once" else 0)


def _level(grid: torch.Tensor, with_pairs: bool) -> Level:
    table = neighbour_table(grid, torch.zeros(len(grid), dtype=torch.int64), 1)
    return Level(table, pair_list(table) if with_pairs else None, (), None, None)


def _occupied(share: float, side: int) -> torch.Tensor:
    return (torch.rand(side, side, side, generator=torch.Generator().manual_seed(1)) < share).nonzero()


@pytest.mark.parametrize("with_pairs", [True, False])
@pytest.mark.parametrize("share", [1.1, 0.3])
def test_equals_conv3d_on_a_dense_grid(gathered: None, with_pairs: bool, share: float) -> None:
    torch.manual_seed(0)
    grid = _occupied(share, 6)
    convolution = SparseConvolution(4, 5).double()
    x = torch.randn(len(grid), 4, dtype=torch.float64)
    dense = torch.zeros(1, 4, 6, 6, 6, dtype=torch.float64)
    dense[0, :, grid[:, 0], grid[:, 1], grid[:, 2]] = x.t()
    kernel = convolution.weight.view(3, 3, 3, 4, 5).permute(4, 3, 0, 1, 2)
    wanted = F.conv3d(dense, kernel, convolution.bias, padding=1)[
        0, :, grid[:, 0], grid[:, 1], grid[:, 2]
    ].t()
    torch.testing.assert_close(convolution(x, _level(grid, with_pairs)), wanted, rtol=0, atol=1e-12)
    with torch.no_grad():
        torch.testing.assert_close(convolution(x, _level(grid, with_pairs)), wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("with_pairs", [True, False])
def test_gradients(gathered: None, with_pairs: bool) -> None:
    torch.manual_seed(0)
    grid = _occupied(0.3, 3)
    level = _level(grid, with_pairs)
    convolution = SparseConvolution(2, 3).double()
    x = torch.randn(len(grid), 2, dtype=torch.float64, requires_grad=True)

    def run(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        parameters = {"weight": weight, "bias": bias}
        return torch.func.functional_call(convolution, parameters, (x, level))

    weight, bias = convolution.weight.detach().requires_grad_(), convolution.bias.detach().requires_grad_()
    assert torch.autograd.gradcheck(run, (x, weight, bias))


def test_at_rows_equals_the_rows_of_the_whole() -> None:
    torch.manual_seed(0)
    grid = _occupied(0.3, 6)
    level = _level(grid, True)
    convolution = SparseConvolution(4, 5).double()
    x = torch.randn(len(grid), 4, dtype=torch.float64)
    rows = torch.tensor([3, 0, 11])
    part = convolution(x, level, rows)
    torch.testing.assert_close(part, convolution(x, level)[rows], rtol=0, atol=1e-12)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("count", [1, 2 * CHUNK - 1, 2 * CHUNK, 3 * CHUNK + 7])
def test_tall_product_equals_the_plain_one(threads: int, count: int) -> None:
    torch.manual_seed(0)
    rows = torch.randn(count, 3, dtype=torch.float64)
    grads = torch.randn(count, 5, dtype=torch.float64)
    out = torch.full((3, 5), float("nan"), dtype=torch.float64)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(threads)
        tall_product(rows, grads, out)
    finally:
        torch.set_num_threads(before)
    torch.testing.assert_close(out, rows.t() @ grads, rtol=0, atol=1e-11)

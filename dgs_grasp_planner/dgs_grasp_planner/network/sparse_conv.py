"""Submanifold sparse 3x3x3 convolution in pure PyTorch: over occupied pairs (CPU, fp32), or one dense gather."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from dgs_grasp_planner.network.geometry import Level, PairList

CENTRE = 13
"""The kernel offset that pairs every row with itself."""
BLOCK = 1 << 22
"""Bytes that a dense convolution gathers at a time on a CPU."""
AT_ONCE = 1 << 17
"""Values up to which the rows of all offsets are gathered in one call; more would leave the cache."""


def _rows_by_offset(x: Tensor, index: Tensor, count: tuple[int, ...]) -> Iterator[Tensor]:
    """Rows (count[k], C) of x for every offset k; what was yielded is overwritten by the next."""
    if index.shape[0] * x.shape[1] <= AT_ONCE:
        yield from x.index_select(0, index).split(count)
        return
    buffer = x.new_empty(max(count), x.shape[1])
    for k, part in enumerate(index.split(count)):
        yield x if k == CENTRE else torch.index_select(x, 0, part, out=buffer[: part.shape[0]])


def _sum_by_destination(products: Tensor, pairs: PairList) -> Tensor:
    return F.embedding_bag(pairs.order, products, pairs.start, mode="sum", include_last_offset=True)


def convolve_pairs(x: Tensor, weight: Tensor, pairs: PairList) -> Tensor:
    """Gather, one small GEMM per kernel offset, segment sum: x (V, C_in), weight (27, C_in, C_out) -> (V, C_out)."""
    products = x.new_empty(pairs.source.shape[0], weight.shape[2])
    parts = zip(_rows_by_offset(x, pairs.source, pairs.count), products.split(pairs.count), strict=True)
    for k, (rows, out) in enumerate(parts):
        torch.mm(rows, weight[k], out=out)
    return _sum_by_destination(products, pairs)


def gather_neighbours(x: Tensor, neighbours: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """(S, 27 * C) features of the neighbours of S rows, zero where empty, from (V, C) features and an (S, 27) table.

    On a CPU so few rows at a time that they stay in its cache: all at once, a product took two to three times as long.

    Yields:
        which rows, and their features.
    """
    padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
    count, width = neighbours.shape[0], 27 * x.shape[1]
    rows = max(BLOCK // (width * x.element_size()), 1) if x.device.type == "cpu" else max(count, 1)
    for start in range(0, max(count, 1), rows):
        part = slice(start, start + rows)
        yield part, padded.index_select(0, neighbours[part].reshape(-1)).view(-1, width)


def convolve_dense(x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
    """The same convolution as products over all 27 places, (V, C_in) -> (S, C_out)."""
    flat = weight.reshape(-1, weight.shape[2])
    return torch.cat([around @ flat for _, around in gather_neighbours(x, neighbours)])


CHUNK = 256
"""Rows per product of `tall_product`."""


def tall_product(rows: Tensor, grads: Tensor, out: Tensor) -> None:
    """Write `rows.t() @ grads` of tall matrices (n, A) and (n, B) to `out` (A, B).

    With several threads the BLAS splits the long sum of one product among them and makes them meet many times. Beside
    another busy process that took 10 to 20 times as long as here, where every thread has whole products of its own.
    """
    count = rows.shape[0]
    whole = count // CHUNK * CHUNK
    if whole < 2 * CHUNK or rows.device.type != "cpu" or torch.get_num_threads() == 1:
        torch.mm(rows.t(), grads, out=out)
        return
    left = rows[:whole].view(-1, CHUNK, rows.shape[1]).transpose(1, 2)
    torch.sum(torch.bmm(left, grads[:whole].view(-1, CHUNK, grads.shape[1])), 0, out=out)
    if whole < count:
        out.addmm_(rows[whole:].t(), grads[whole:])


def _mirrored(weight: Tensor) -> Tensor:
    # Occupied pairs come in opposite twins: the input gradient is a convolution with the mirrored, transposed kernel.
    return weight.flip(0).transpose(1, 2).contiguous()


class _PairConvolution(torch.autograd.Function):
    """`convolve_pairs` whose gradients need no scatter.

    Pair (i, j) of offset k has the twin (j, i) of offset 26 - k: what the twin's kernel adds to row j comes from row i.
    So the output gradients gathered by the sources of offset k serve both gradients of offset 26 - k.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, pairs: PairList) -> Tensor:
        ctx.pairs = pairs
        ctx.save_for_backward(x, weight)
        return convolve_pairs(x, weight, pairs)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor, None]:
        x, weight = ctx.saved_tensors
        pairs: PairList = ctx.pairs
        products = x.new_empty(pairs.source.shape[0], x.shape[1]) if ctx.needs_input_grad[0] else None
        grad_weight = torch.zeros_like(weight)
        grads_by_offset = _rows_by_offset(grad.contiguous(), pairs.source, pairs.count)
        rows_by_offset = _rows_by_offset(x.contiguous(), pairs.destination, pairs.count)
        begin = 0
        for k, (grads, rows) in enumerate(zip(grads_by_offset, rows_by_offset, strict=True)):
            end = begin + pairs.count[k]
            tall_product(rows, grads, grad_weight[26 - k])
            if products is not None:
                torch.mm(grads, weight[26 - k].t(), out=products[begin:end])
            begin = end
        return None if products is None else _sum_by_destination(products, pairs), grad_weight, None


class _DenseConvolution(torch.autograd.Function):
    """`convolve_dense` that keeps only its input for the backward pass, not the 27 times larger gathered matrix.

    By the twins of `_PairConvolution` the output gradients, gathered once, serve both gradients.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight, neighbours)
        return convolve_dense(x, weight, neighbours)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor, None]:
        x, weight, neighbours = ctx.saved_tensors
        mirrored, c_in = _mirrored(weight).view(-1, x.shape[1]), x.shape[1]
        grads, dtype = [], torch.promote_types(x.dtype, torch.float32)
        grad_weight = x.new_zeros(c_in, 27 * weight.shape[2], dtype=dtype)
        for part, around in gather_neighbours(grad.contiguous(), neighbours):
            if ctx.needs_input_grad[0]:
                grads.append(around @ mirrored)
            grad_weight += x[part].t() @ around
        grad_weight = grad_weight.view(c_in, 27, -1).flip(1).transpose(0, 1).to(weight.dtype)
        return torch.cat(grads) if grads else None, grad_weight, None


class SparseConvolution(nn.Module):
    """3x3x3 convolution at occupied voxels that reads occupied voxels only; (V, C_in) -> (V, C_out)."""

    def __init__(self, c_in: int, c_out: int, bias: bool = True):
        super().__init__()
        # About 9 of the 27 places of a surface are occupied: that is the fan-in.
        self.weight = nn.Parameter(torch.randn(27, c_in, c_out) / (9 * c_in) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(c_out)) if bias else None

    def forward(self, x: Tensor, level: Level, rows: Tensor | None = None) -> Tensor:
        """Over the pairs where the level has them, else by a dense gather; at `rows` (S,) only, where given."""
        weight, device = self.weight, x.device.type
        if torch.is_autocast_enabled(device):
            dtype = torch.get_autocast_dtype(device)
            x, weight = x.to(dtype), weight.to(dtype)
        if rows is not None:
            y = convolve_dense(x, weight, level.neighbours.index_select(0, rows))
        elif level.pairs is None:
            y = _DenseConvolution.apply(x, weight, level.neighbours)
        else:
            y = _PairConvolution.apply(x, weight, level.pairs)
        return y if self.bias is None else y + self.bias.to(y.dtype)

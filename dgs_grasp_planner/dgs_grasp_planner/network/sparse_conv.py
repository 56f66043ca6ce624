"""Submanifold sparse 3x3x3 convolution in pure PyTorch: over occupied pairs on a CPU, one dense gather on a GPU."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from dgs_grasp_planner.network.geometry import Level, PairList


def convolve_pairs(x: Tensor, weight: Tensor, pairs: PairList) -> Tensor:
    """Gather, one small GEMM per kernel offset, segment sum.

    Args:
        x: (V, C_in).
        weight: (27, C_in, C_out).

    Returns:
        (V, C_out).
    """
    gathered = x.index_select(0, pairs.source)
    products = x.new_empty(gathered.shape[0], weight.shape[2])
    for k, (rows, out) in enumerate(
        zip(gathered.split(pairs.count), products.split(pairs.count), strict=True)
    ):
        if pairs.count[k]:
            torch.mm(rows, weight[k], out=out)
    return F.embedding_bag(pairs.order, products, pairs.start, mode="sum", include_last_offset=True)


def gather_neighbours(x: Tensor, neighbours: Tensor) -> Tensor:
    """(S, 27 * C) features of the neighbours of S rows, zero where empty, from (V, C) features and an (S, 27) table."""
    padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
    return padded.index_select(0, neighbours.reshape(-1)).view(neighbours.shape[0], -1)


def convolve_dense(x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
    """The same convolution as one GEMM over all 27 places, (V, C_in) -> (V, C_out)."""
    return gather_neighbours(x, neighbours) @ weight.reshape(-1, weight.shape[2])


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
    """`convolve_pairs` whose gradients need no scatter."""

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
        grad = grad.contiguous()
        grad_x = convolve_pairs(grad, _mirrored(weight), pairs) if ctx.needs_input_grad[0] else None
        grad_weight = torch.zeros_like(weight)
        inputs = x.index_select(0, pairs.source).split(pairs.count)
        outputs = grad.index_select(0, pairs.destination).split(pairs.count)
        for k, (rows, grads) in enumerate(zip(inputs, outputs, strict=True)):
            if pairs.count[k]:
                tall_product(rows, grads, grad_weight[k])
        return grad_x, grad_weight, None


class _DenseConvolution(torch.autograd.Function):
    """`convolve_dense` that keeps only its input for the backward pass, not the 27 times larger gathered matrix."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight, neighbours)
        return convolve_dense(x, weight, neighbours)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor, None]:
        x, weight, neighbours = ctx.saved_tensors
        grad = grad.contiguous()
        grad_x = convolve_dense(grad, _mirrored(weight), neighbours) if ctx.needs_input_grad[0] else None
        return grad_x, (gather_neighbours(x, neighbours).t() @ grad).view_as(weight), None


class SparseConvolution(nn.Module):
    """3x3x3 convolution at occupied voxels that reads occupied voxels only; (V, C_in) -> (V, C_out)."""

    def __init__(self, c_in: int, c_out: int, bias: bool = True):
        super().__init__()
        # About 9 of the 27 places of a surface are occupied: that is the fan-in.
        self.weight = nn.Parameter(torch.randn(27, c_in, c_out) / (9 * c_in) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(c_out)) if bias else None

    def _operands(self, x: Tensor) -> tuple[Tensor, Tensor]:
        device = x.device.type
        if torch.is_autocast_enabled(device):
            dtype = torch.get_autocast_dtype(device)
            return x.to(dtype), self.weight.to(dtype)
        return x, self.weight

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """Over the pairs where the level has them, else by a dense gather."""
        x, weight = self._operands(x)
        if level.pairs is not None:
            y = (
                _PairConvolution.apply(x, weight, level.pairs)
                if torch.is_grad_enabled()
                else convolve_pairs(x, weight, level.pairs)
            )
        elif torch.is_grad_enabled():
            y = _DenseConvolution.apply(x, weight, level.neighbours)
        else:
            y = convolve_dense(x, weight, level.neighbours)
        return y if self.bias is None else y + self.bias.to(y.dtype)

    def at_rows(self, x: Tensor, neighbours: Tensor) -> Tensor:
        """The output at chosen rows: (V, C_in) features and the (S, 27) table of those rows -> (S, C_out)."""
        x, weight = self._operands(x)
        y = convolve_dense(x, weight, neighbours)
        return y if self.bias is None else y + self.bias.to(y.dtype)

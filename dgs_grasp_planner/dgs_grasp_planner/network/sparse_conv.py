"""Submanifold sparse 3x3x3 convolution in pure PyTorch: gather the neighbours of some rows, one matrix product."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

GATHERED = 1 << 20
"""Bytes of neighbours gathered at a time on a CPU.

Measured (2 MiB of second-level cache): 0.5 to 2 MiB take the same time, all rows at once 3 to 4 times as long.
"""


def _gathered(x: Tensor, neighbours: Tensor) -> Iterator[tuple[slice, Tensor]]:
    """Some rows of the (S, 27) table at a time, and the features (n, 27 * C) of their neighbours, zero where empty."""
    padded = torch.cat([x, x.new_zeros(1, x.shape[1])])
    total = neighbours.shape[0]
    at_once = max(1, GATHERED // (27 * x.shape[1] * x.element_size())) if x.device.type == "cpu" else total
    for begin in range(0, total, at_once):
        rows = slice(begin, begin + at_once)
        yield rows, padded.index_select(0, neighbours[rows].reshape(-1)).view(-1, 27 * x.shape[1])


def convolve(x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
    """The convolution at S rows, without gradient.

    Args:
        x: (V, C_in).
        weight: (27, C_in, C_out).
        neighbours: (S, 27) rows of x, V where there is none.

    Returns:
        (S, C_out).
    """
    out = x.new_empty(neighbours.shape[0], weight.shape[2])
    for rows, gathered in _gathered(x, neighbours):
        torch.mm(gathered, weight.flatten(0, 1), out=out[rows])
    return out


class _Convolution(torch.autograd.Function):
    """`convolve` at all V rows. Keeps its input for the backward pass, not the 27 times larger gathered matrix."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor, neighbours: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight, neighbours)
        return convolve(x, weight, neighbours)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        """Row i is row j's neighbour through offset 26 - k if j is row i's through k: no gradient needs a scatter."""
        x, weight, neighbours = ctx.saved_tensors
        mirrored = weight.flip(0).transpose(1, 2)
        grad_x = torch.empty_like(x)
        # Summed up over many parts, which is too coarse in half precision.
        grad_mirrored = x.new_zeros(mirrored.shape, dtype=torch.promote_types(x.dtype, torch.float32))
        for rows, gathered in _gathered(grad.contiguous(), neighbours):
            torch.mm(gathered, mirrored.flatten(0, 1), out=grad_x[rows])
            grad_mirrored += (gathered.t() @ x[rows]).view_as(grad_mirrored)
        return grad_x, grad_mirrored.to(weight.dtype).flip(0).transpose(1, 2), None


class SparseConvolution(nn.Module):
    """3x3x3 convolution at occupied voxels that reads occupied voxels only."""

    def __init__(self, c_in: int, c_out: int, bias: bool = True):
        super().__init__()
        # About 9 of the 27 places of a surface are occupied: that is the fan-in.
        self.weight = nn.Parameter(torch.randn(27, c_in, c_out) / (9 * c_in) ** 0.5)
        self.bias = nn.Parameter(torch.zeros(c_out)) if bias else None

    def forward(self, x: Tensor, neighbours: Tensor) -> Tensor:
        """(V, C_in) features and a level's (V, 27) table, or the (S, 27) table of some rows -> (V or S, C_out).

        Gradients need the whole table.
        """
        weight, device = self.weight, x.device.type
        if torch.is_autocast_enabled(device):
            dtype = torch.get_autocast_dtype(device)
            x, weight = x.to(dtype), weight.to(dtype)
        y = _Convolution.apply(x, weight, neighbours)
        return y if self.bias is None else y + self.bias.to(y.dtype)

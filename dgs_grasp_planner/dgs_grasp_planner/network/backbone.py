"""PTv3 encoder-decoder (Wu et al., 2024): features per voxel from several resolutions. LayerNorm throughout."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from dgs_grasp_planner.network.attention import Block
from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.geometry import Level
from dgs_grasp_planner.network.sparse_conv import SparseConvolution


class _MaxPool(torch.autograd.Function):
    """Maximum over the children of every parent voxel; the gradient needs no scatter."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, child: Tensor, parent: Tensor) -> Tensor:
        y = x.index_select(0, child.reshape(-1)).view(*child.shape, -1).amax(1)
        ctx.save_for_backward(x, y, parent)
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        x, y, parent = ctx.saved_tensors
        return grad.index_select(0, parent) * (x == y.index_select(0, parent)), None, None


class Down(nn.Module):
    """To the next coarser level: linear, maximum over the up to 8 children, norm, GELU; (V, A) -> (V_next, B)."""

    def __init__(self, c_in: int, c_out: int):
        super().__init__()
        self.linear, self.norm = nn.Linear(c_in, c_out), nn.LayerNorm(c_out)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """`level` is the finer one."""
        return F.gelu(self.norm(_MaxPool.apply(self.linear(x), level.child, level.parent)))


class Up(nn.Module):
    """To the next finer level: coarse features copied to the children plus the encoder's own; -> (V, C)."""

    def __init__(self, c_coarse: int, c_skip: int, c_out: int):
        super().__init__()
        self.coarse = nn.Sequential(nn.Linear(c_coarse, c_out), nn.LayerNorm(c_out), nn.GELU())
        self.skip = nn.Sequential(nn.Linear(c_skip, c_out), nn.LayerNorm(c_out), nn.GELU())

    def forward(self, coarse: Tensor, skip: Tensor, level: Level) -> Tensor:
        """`level` is the finer one."""
        return self.skip(skip) + self.coarse(coarse).index_select(0, level.parent)


class Stem(nn.Module):
    """Sparse convolutions with norm and GELU; (V, F) -> (V, C)."""

    def __init__(self, c_in: int, c_out: int, convolutions: int):
        super().__init__()
        widths = [c_in] + [c_out] * convolutions
        self.convolutions = nn.ModuleList(SparseConvolution(a, b, bias=False) for a, b in pairwise(widths))
        self.norms = nn.ModuleList(nn.LayerNorm(c_out) for _ in range(convolutions))

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """At the finest level."""
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            x = F.gelu(norm(convolution(x, level)))
        return x


class Backbone(nn.Module):
    """(V, feature_width) input features -> (V, decoder_channels[0]) features at the finest level."""

    def __init__(self, config: NetworkConfig):
        super().__init__()
        enc, dec = config.encoder_channels, config.decoder_channels
        total = sum(config.encoder_depths)
        drops = iter(config.drop_path * i / max(total - 1, 1) for i in range(total))

        def blocks(width: int, depth: int, level: int, drop: list[float]) -> nn.ModuleList:
            return nn.ModuleList(
                Block(width, config.head_dim, config.mlp_ratio, (i + level) % len(config.orders), drop[i])
                for i in range(depth)
            )

        self.stem = Stem(config.feature_width, enc[0], config.stem_convolutions)
        self.encoder = nn.ModuleList(
            blocks(width, depth, level, [next(drops) for _ in range(depth)])
            for level, (width, depth) in enumerate(zip(enc, config.encoder_depths, strict=True))
        )
        self.down = nn.ModuleList(Down(a, b) for a, b in pairwise(enc))
        coarse = (*dec[1:], enc[-1])
        self.up = nn.ModuleList(Up(c, s, d) for c, s, d in zip(coarse, enc[:-1], dec, strict=True))
        self.decoder = nn.ModuleList(
            blocks(width, depth, level, [0.0] * depth)
            for level, (width, depth) in enumerate(zip(dec, config.decoder_depths, strict=True))
        )

    def forward(self, x: Tensor, levels: tuple[Level, ...]) -> Tensor:
        """Down the encoder and up the decoder; `levels` finest first."""
        x = self.stem(x, levels[0])
        skips = []
        for i, level in enumerate(levels):
            if i:
                x = self.down[i - 1](x, levels[i - 1])
            for block in self.encoder[i]:
                x = block(x, level)
            skips.append(x)
        for i in range(len(levels) - 2, -1, -1):
            x = self.up[i](x, skips[i], levels[i])
            for block in self.decoder[i]:
                x = block(x, levels[i])
        return x

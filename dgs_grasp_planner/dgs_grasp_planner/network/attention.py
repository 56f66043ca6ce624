"""Self-attention in windows along a space-filling curve, and the transformer block of PTv3."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgs_grasp_planner.network.geometry import Level, Patches
from dgs_grasp_planner.network.sparse_conv import SparseConvolution


def attend(q: Tensor, k: Tensor, v: Tensor, mask: Tensor | None) -> Tensor:
    """Scaled dot-product attention of (P, heads, K, D) tensors; mask (P, K) bool, False = key not there."""
    bias = None if mask is None else mask[:, None, None, :]
    if torch.is_grad_enabled() and q.device.type == "cpu" and q.dtype == torch.bfloat16:
        # The CPU's backward kernel is several times slower in bf16 than in fp32.
        with torch.autocast("cpu", enabled=False):
            return F.scaled_dot_product_attention(q.float(), k.float(), v.float(), attn_mask=bias).to(v.dtype)
    return F.scaled_dot_product_attention(q, k, v, attn_mask=bias)


def mlp(width: int, ratio: int) -> nn.Sequential:
    """Two linear layers with GELU, (V, width) -> (V, width)."""
    return nn.Sequential(nn.Linear(width, ratio * width), nn.GELU(), nn.Linear(ratio * width, width))


class PatchAttention(nn.Module):
    """Multi-head self-attention inside windows of rows; (V, C) -> (V, C)."""

    def __init__(self, width: int, head_dim: int):
        super().__init__()
        self.heads = max(width // head_dim, 1)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def in_patch_order(self, x: Tensor, size: int, mask: Tensor | None) -> Tensor:
        """Attention of (P * size, C) rows that already stand in patch order; mask (P, size) or None."""
        width = x.shape[1]
        q, k, v = self.qkv(x).view(-1, size, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
        return self.out(attend(q, k, v, mask).transpose(1, 2).reshape(-1, width))

    def at_places(self, x: Tensor, size: int, mask: Tensor | None, places: Tensor) -> Tensor:
        """The same numbers at S ascending `places` of the patch order only, (P * size, C) -> (S, C)."""
        width = x.shape[1]
        query, key_value = self.qkv.weight.split((width, 2 * width))
        query_bias, key_value_bias = self.qkv.bias.split((width, 2 * width))
        k, v = (
            F.linear(x, key_value, key_value_bias)
            .view(-1, size, 2, self.heads, width // self.heads)
            .permute(2, 0, 3, 1, 4)
        )
        window, count = places // size, torch.bincount(places // size, minlength=k.shape[0])
        # A window's queries stand one after another, then come empty ones up to the fullest window's number.
        most = int(count.amax())
        rank = torch.arange(len(places), device=x.device) - (count.cumsum(0) - count)[window]
        asked = window * most + rank
        q = x.new_zeros(len(count) * most, width).index_copy(
            0, asked, F.linear(x.index_select(0, places), query, query_bias)
        )
        q = q.view(-1, most, self.heads, width // self.heads).transpose(1, 2)
        return self.out(attend(q, k, v, mask).transpose(1, 2).reshape(-1, width).index_select(0, asked))

    def forward(self, x: Tensor, patches: Patches) -> Tensor:
        """(V, C) -> (V, C) along the curve of `patches`."""
        y = self.in_patch_order(x.index_select(0, patches.gather), patches.size, patches.mask)
        return y.index_select(0, patches.back)


class DropPath(nn.Module):
    """Drops the residual branch of random rows in training (stochastic depth)."""

    def __init__(self, probability: float):
        super().__init__()
        self.probability = probability

    def forward(self, x: Tensor) -> Tensor:
        """(V, C) -> (V, C), the kept rows scaled up."""
        if not self.training or self.probability == 0.0:
            return x
        keep = 1.0 - self.probability
        return x * (torch.rand(x.shape[0], 1, device=x.device) < keep).to(x.dtype) / keep


class Block(nn.Module):
    """PTv3's block: sparse convolution as position encoding, window attention, MLP; pre-norm residuals."""

    def __init__(self, width: int, head_dim: int, mlp_ratio: int, order: int, drop_path: float):
        super().__init__()
        self.order = order
        self.position = SparseConvolution(width, width)
        self.position_linear = nn.Linear(width, width)
        self.position_norm = nn.LayerNorm(width)
        self.norm1, self.attention = nn.LayerNorm(width), PatchAttention(width, head_dim)
        self.norm2, self.mlp = nn.LayerNorm(width), mlp(width, mlp_ratio)
        self.drop = DropPath(drop_path)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """(V, C) -> (V, C) at one level."""
        x = x + self.position_norm(self.position_linear(self.position(x, level)))
        x = x + self.drop(self.attention(self.norm1(x), level.patches[self.order]))
        return x + self.drop(self.mlp(self.norm2(x)))

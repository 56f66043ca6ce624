"""Module II: offset, pre-grasp and final joints, by self-attention over score, rotation and features."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_grasp_planner.network.attention import PatchAttention, mlp
from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.geometry import Level
from dgs_grasp_planner.network.rotation import orthonormal_6d
from dgs_grasp_planner.network.sparse_conv import SparseConvolution

ACTIVE_JOINTS = len(HAND.driven)
TYPICAL_FLEXION = ((0.0, 0.35, 0.15, 0.15), (0.0, 0.6, 0.6, 0.6))
"""So much more than in the open hand the four joints of a finger are bent in the untrained network's answer, pre-grasp
and final grasp [rad]."""


class ModuleTwoOutput(NamedTuple):
    """Module II's answer for S rows.

    Attributes:
        offset: (S, 3) from the reference point to the TCP [m], input frame.
        j_init, j_end: (S, D) active joints of pre-grasp and final grasp [rad], not limited.
    """

    offset: Tensor
    j_init: Tensor
    j_end: Tensor


class AttentionLayer(nn.Module):
    """Pre-norm window attention and MLP on rows that stand in patch order."""

    def __init__(self, width: int, head_dim: int, mlp_ratio: int):
        super().__init__()
        self.norm1, self.attention = nn.LayerNorm(width), PatchAttention(width, head_dim)
        self.norm2, self.mlp = nn.LayerNorm(width), mlp(width, mlp_ratio)

    def forward(self, x: Tensor, size: int, mask: Tensor | None, places: Tensor | None = None) -> Tensor:
        """(P * size, C) -> (P * size, C), or (S, C) at ascending `places` of them only; mask (P, size) or None."""
        normed = self.norm1(x)
        if places is None:
            x = x + self.attention.in_patch_order(normed, size, mask)
        else:
            x = x.index_select(0, places) + self.attention.at_places(normed, size, mask, places)
        return x + self.mlp(self.norm2(x))


class ModuleTwo(nn.Module):
    """Self-attention encoder, then sparse convolutions, then a linear head."""

    def __init__(self, config: NetworkConfig):
        super().__init__()
        width = config.module_two_width
        self.offset_scale = config.offset_scale
        self.mix = nn.Linear(config.decoder_channels[0] + 2 + 6, width)
        self.layers = nn.ModuleList(
            AttentionLayer(width, config.head_dim, config.mlp_ratio) for _ in range(config.module_two_layers)
        )
        self.convolutions = nn.ModuleList(
            SparseConvolution(width, width) for _ in range(config.module_two_convolutions)
        )
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(config.module_two_convolutions))
        self.out = nn.Linear(width, 3 + 2 * ACTIVE_JOINTS)
        opened = HAND.reduce(HAND.open_hand)
        bent = opened + np.array(TYPICAL_FLEXION)[:, HAND.driven % JOINTS_PER_FINGER]
        with torch.no_grad():
            self.out.weight.mul_(0.1)
            self.out.bias.copy_(torch.tensor([0.0] * 3 + bent.ravel().tolist()))

    def _encode(
        self,
        inputs: tuple[Tensor, Tensor, Tensor],
        gather: Tensor,
        size: int,
        mask: Tensor | None,
        places: Tensor | None = None,
    ) -> Tensor:
        """Self-attention of the rows `gather`, in patch order -> (P * size, width), or (S, width) at `places` of it."""
        features, score_logits, rotation6d = (t.index_select(0, gather) for t in inputs)
        rotation = orthonormal_6d(rotation6d.float()).to(features.dtype)
        # Softmax of two; torch's is slow along so short an axis.
        better = score_logits[:, 1:].float() - score_logits[:, :1].float()
        score = torch.cat([-better, better], 1).sigmoid().to(features.dtype)
        x = self.mix(torch.cat([features, score, rotation], 1))
        for layer in self.layers[:-1]:
            x = layer(x, size, mask)
        return self.layers[-1](x, size, mask, places)

    def _decode(self, x: Tensor) -> ModuleTwoOutput:
        offset, j_init, j_end = self.out(x).split((3, ACTIVE_JOINTS, ACTIVE_JOINTS), dim=1)
        return ModuleTwoOutput(offset * self.offset_scale, j_init, j_end)

    def forward(
        self,
        features: Tensor,
        score_logits: Tensor,
        rotation6d: Tensor,
        level: Level,
        rows: Tensor | None = None,
    ) -> ModuleTwoOutput:
        """Answer for all V rows, or exactly the same numbers for the S `rows` only, at a fraction of the cost.

        Args:
            features: (V, C).
            score_logits: (V, 2); in training those of the labels, see `dgs_net.teacher_logits`.
            rotation6d: (V, 6) one rotation per row; only its direction counts.
            level: tables of the finest level.
            rows: (S,) int64 or None for all.
        """
        inputs = (features, score_logits, rotation6d)
        if rows is not None:
            return self._at_rows(inputs, level, rows)
        patches = level.patches[0]
        x = self._encode(inputs, patches.gather, patches.size, patches.mask).index_select(0, patches.back)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            x = F.gelu(norm(convolution(x, level)))
        return self._decode(x)

    def _at_rows(self, inputs: tuple[Tensor, Tensor, Tensor], level: Level, rows: Tensor) -> ModuleTwoOutput:
        # Walk back from the wanted rows: what each convolution reads, then the patches that hold those rows.
        needed = [rows]
        for _ in self.convolutions:
            around = level.neighbours.index_select(0, needed[-1]).reshape(-1).long()
            needed.append(torch.unique(around[around < level.rows]))
        source = needed.pop()
        patches = level.patches[0]
        place = patches.back.index_select(0, source)  # ascending, as the rows are along the first curve
        window, window_of_row = torch.unique_consecutive(place // patches.size, return_inverse=True)
        gather = patches.gather.view(-1, patches.size).index_select(0, window).reshape(-1)
        mask = None if patches.mask is None else patches.mask.index_select(0, window)
        places = window_of_row * patches.size + place % patches.size
        x = self._encode(inputs, gather, patches.size, mask, places)
        for convolution, norm in zip(self.convolutions, self.norms, strict=True):
            everywhere = x.new_zeros(level.rows, x.shape[1]).index_copy(0, source, x)
            source = needed.pop()
            x = F.gelu(norm(convolution(everywhere, level, source)))
        return self._decode(x)

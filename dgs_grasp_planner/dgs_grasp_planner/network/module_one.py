"""Module I: score and rotation of every voxel, from the backbone's features by sparse convolutions."""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.geometry import Level
from dgs_grasp_planner.network.rotation import spread_rotations
from dgs_grasp_planner.network.sparse_conv import SparseConvolution

SCORE_PRIOR = 0.02
"""Share of graspable voxels that the untrained score head predicts."""


class ModuleOneOutput(NamedTuple):
    """Module I's answer for V voxels and K rotation hypotheses.

    Attributes:
        features: (V, C) backbone features.
        score_logits: (V, 2) not graspable, graspable.
        rotation6d: (V, K, 6) first two columns of the rotation of `hand_tcp` in the input frame, not normalised.
        hypothesis_logits: (V, K) which hypothesis is the likely one.
    """

    features: Tensor
    score_logits: Tensor
    rotation6d: Tensor
    hypothesis_logits: Tensor


class Head(nn.Module):
    """Sparse convolution, norm, GELU, linear; (V, C) -> (V, outputs)."""

    def __init__(self, width: int, outputs: int):
        super().__init__()
        self.convolution = SparseConvolution(width, width)
        self.norm = nn.LayerNorm(width)
        self.out = nn.Linear(width, outputs)

    def forward(self, x: Tensor, level: Level) -> Tensor:
        """At the finest level."""
        return self.out(F.gelu(self.norm(self.convolution(x, level))))


class ModuleOne(nn.Module):
    """Score and rotation heads."""

    def __init__(self, config: NetworkConfig):
        super().__init__()
        width, self.hypotheses = config.decoder_channels[0], config.rotation_hypotheses
        self.score = Head(width, 2)
        self.rotation = Head(width, 7 * self.hypotheses)
        with torch.no_grad():
            half = 0.5 * float(torch.logit(torch.tensor(SCORE_PRIOR)))
            self.score.out.bias.copy_(torch.tensor([-half, half]))
            # Small weights: the hypotheses start from their spread biases and differ from the first step on.
            self.rotation.out.weight.mul_(0.1)
            spread = spread_rotations(self.hypotheses, config.frame).flatten()
            self.rotation.out.bias.copy_(torch.cat([spread, torch.zeros(self.hypotheses)]))

    def forward(self, features: Tensor, level: Level) -> ModuleOneOutput:
        """Both heads on (V, C) features."""
        score, rotation, k = self.score(features, level), self.rotation(features, level), self.hypotheses
        return ModuleOneOutput(features, score, rotation[:, : 6 * k].reshape(-1, k, 6), rotation[:, 6 * k :])

"""DGS-Net (paper, section IV): backbone, module I and module II in one module."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dgs_grasp_planner.network.backbone import Backbone
from dgs_grasp_planner.network.batch import VoxelBatch
from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.fixed_shapes import FixedShapes
from dgs_grasp_planner.network.module_one import ModuleOne, ModuleOneOutput
from dgs_grasp_planner.network.module_two import ModuleTwo, ModuleTwoOutput

TEACHER_LOGIT = 5.0


def teacher_logits(graspable: Tensor) -> Tensor:
    """(V, 2) score logits that say the labels (V,) bool with near certainty: teacher forcing of module II."""
    sign = torch.where(graspable, TEACHER_LOGIT, -TEACHER_LOGIT)
    return torch.stack([-sign, sign], 1)


class DGSNet(nn.Module):
    """Grasps for every voxel of a batch of clouds.

    Module I answers score and rotation for all voxels; module II takes both (in training the ground truth) and answers
    offset and joints, for all voxels or for chosen rows.
    """

    def __init__(self, config: NetworkConfig):
        super().__init__()
        self.config = config
        self.backbone = Backbone(config)
        self.one = ModuleOne(config)
        self.two = FixedShapes(config) if config.fixed_shapes else ModuleTwo(config)

    @property
    def parameter_count(self) -> int:
        """Number of trainable values."""
        return sum(p.numel() for p in self.parameters())

    def module_one(self, batch: VoxelBatch) -> ModuleOneOutput:
        """Features (V, C), score logits (V, 2), rotations (V, K, 6) and their logits (V, K)."""
        dtype = self.one.score.out.weight.dtype
        features = self.backbone(batch.features.to(dtype), batch.levels)
        return self.one(features, batch.levels[0])

    def module_two(
        self,
        one: ModuleOneOutput,
        hypothesis: Tensor,
        batch: VoxelBatch,
        rows: Tensor | None = None,
    ) -> ModuleTwoOutput:
        """Offset (S, 3) [m] and active joints (S, D), (S, D) [rad] of one hypothesis (V,) per voxel."""
        if isinstance(self.two, FixedShapes):
            return self.two(one.features, hypothesis, batch.levels[0], rows)
        rotation = rotation_of(one, hypothesis)
        return self.two(one.features, one.score_logits, rotation, batch.levels[0], rows)

    def forward(self, batch: VoxelBatch) -> tuple[ModuleOneOutput, ModuleTwoOutput]:
        """Both modules on all voxels, module II with module I's scores and likeliest rotations."""
        one = self.module_one(batch)
        return one, self.module_two(one, one.hypothesis_logits.argmax(1), batch)


def rotation_of(one: ModuleOneOutput, hypothesis: Tensor) -> Tensor:
    """(V, 6) rotations of module I: one hypothesis (V,) per voxel."""
    return one.rotation6d.gather(1, hypothesis[:, None, None].expand(-1, 1, 6))[:, 0]

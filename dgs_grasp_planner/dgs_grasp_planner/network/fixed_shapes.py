"""In module II's place: a few fixed shapes of the hand, one per hypothesis of module I (after HGC-Net).

Li et al., HGC-Net: Deep Anthropomorphic Hand Grasping in Clutter, ICRA 2022: every point answers for each of five grasp
types whether it can be grasped so, and with which pose; the joints are the type's.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dgs_grasp_planner.network.config import NetworkConfig
from dgs_grasp_planner.network.geometry import Level
from dgs_grasp_planner.network.module_one import Head
from dgs_grasp_planner.network.module_two import ACTIVE_JOINTS, ModuleTwoOutput


class FixedShapes(nn.Module):
    """Offset per shape by a head of module I's form; joints from a table that is no weight.

    Attributes:
        shapes: (T, 2, D) active joints of pre-grasp and final grasp [rad]; zeros until a training fills them in.
    """

    shapes: Tensor

    def __init__(self, config: NetworkConfig):
        super().__init__()
        self.count, self.offset_scale = config.fixed_shapes, config.offset_scale
        self.head = Head(config.decoder_channels[0], 3 * self.count)
        self.register_buffer("shapes", torch.zeros(self.count, 2, ACTIVE_JOINTS))

    def nearest(self, j_init: Tensor, j_end: Tensor) -> Tensor:
        """(P,) the shape nearest to the joints (P, D) of pre-grasp and final grasp."""
        wanted = torch.stack([j_init, j_end], 1).flatten(1)
        return torch.cdist(wanted, self.shapes.float().flatten(1)).argmin(1)

    def forward(self, features: Tensor, shape: Tensor, level: Level, rows: Tensor | None) -> ModuleTwoOutput:
        """Offset and joints of one shape per voxel.

        Args:
            features: (V, C), shape: (V,) int64.
            level: tables of the finest level.
            rows: (S,) int64 or None for all.
        """
        offset = self.head(features, level).reshape(-1, self.count, 3)
        if rows is not None:
            offset, shape = offset.index_select(0, rows), shape.index_select(0, rows)
        offset = offset.gather(1, shape[:, None, None].expand(-1, 1, 3))[:, 0] * self.offset_scale
        return ModuleTwoOutput(offset, *self.shapes[shape].unbind(1))

"""A small untrained network with weights that make it answer: for tests of everything around the network."""

from __future__ import annotations

from pathlib import Path

import torch

from dgs_grasp_planner.load import planner_with
from dgs_grasp_planner.network import PRESETS, DGSNet, ModelInfo, save_network
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.propose.dgs_net import DgsNet


def eager_network(seed: int = 0) -> DGSNet:
    """A tiny network that takes every point for graspable, from above, with an open hand."""
    torch.manual_seed(seed)
    net = DGSNet(PRESETS["tiny"])
    with torch.no_grad():
        net.one.score.out.bias.copy_(torch.tensor([-2.0, 2.0]))
        net.one.score.out.weight.mul_(0.2)
        net.two.out.weight.mul_(0.1)
        net.two.out.bias[3:].copy_(torch.tensor([0.0, 0.2, 0.1] * 5 + [0.0, 0.5, 0.5] * 5))
    return net


def save_eager_model(folder: Path, name: str = "tiny") -> ModelInfo:
    """Write its files."""
    return save_network(eager_network(), folder, name)


def eager_planner() -> GraspPlanner:
    """The planner that ships, with the eager network."""
    return planner_with(DgsNet(eager_network()))

"""DGS-Net in pure PyTorch: voxels and tables, PTv3 backbone, the two modules, weights. Needs torch and numpy only."""

from __future__ import annotations

from dgs_grasp_planner.network.batch import VoxelBatch, collate, input_features
from dgs_grasp_planner.network.config import PRESETS, NetworkConfig
from dgs_grasp_planner.network.dgs_net import DGSNet
from dgs_grasp_planner.network.weights import ModelInfo, load_network, save_network

__all__ = [
    "PRESETS",
    "DGSNet",
    "ModelInfo",
    "NetworkConfig",
    "VoxelBatch",
    "collate",
    "input_features",
    "load_network",
    "save_network",
]

"""Validation and files of the network's configuration."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.network import PRESETS, DGSNet, NetworkConfig
from dgs_grasp_planner.network.attention import PatchAttention
from tests.support.refused import refused


@pytest.mark.parametrize("name", PRESETS)
def test_json_brings_back_the_same_configuration(name: str) -> None:
    text = json.dumps(PRESETS[name].to_dict())
    assert NetworkConfig.from_dict(json.loads(text)) == PRESETS[name]


@pytest.mark.parametrize(
    "change",
    [
        {"frame": "world"},
        {"features": ["colour"]},
        {"features": []},
        {"features": ["ones", "ones"]},
        {"features": ["height"], "frame": "camera"},
        {"voxel_size": 0.5},
        {"voxel_size": "5 mm"},
        {"grid_bits": 30},
        {"grid_bits": 4},
        {"orders": ["x"]},
        {"orders": []},
        {"encoder_depths": [1, 1]},
        {"encoder_channels": [32], "encoder_depths": [1], "decoder_channels": [], "decoder_depths": []},
        {"decoder_channels": [32, 64]},
        {"decoder_depths": [2]},
        {"fixed_shapes": 3},
        {"encoder_channels": [32, 64, 64, 96, 100]},
        {"patch_size": 1},
        {"patch_size": 12.5},
        {"drop_path": 1.0},
        {"rotation_hypotheses": 0},
        {"offset_scale": 0.0},
        {"module_two_width": 65},
        {"wdith": 3},
    ],
)
def test_wrong_values_are_refused(change: dict[str, Any]) -> None:
    with refused(ErrorCode.PARAMETER_INVALID) as error:
        NetworkConfig.from_dict(change)
    assert next(iter(change)) in error.value.message


def test_what_is_narrower_than_a_head_has_one() -> None:
    net = DGSNet(replace(PRESETS["tiny"], head_dim=48))
    assert {module.heads for module in net.modules() if isinstance(module, PatchAttention)} == {1}


def test_paper_is_the_published_form() -> None:
    paper = PRESETS["paper"]
    assert (paper.frame, paper.rotation_hypotheses, paper.keep_table) == ("camera", 1, True)
    assert paper.encoder_channels == (32, 64, 128, 256, 512)
    assert 45e6 < DGSNet(paper).parameter_count < 48e6

"""Weights files: round trip, and refusal of missing and altered ones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.network import PRESETS, DGSNet, load_network, save_network


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_network(DGSNet(PRESETS["tiny"]), tmp_path, "net", {"step": 12})
    return tmp_path


def _code(folder: Path, name: str = "net") -> ErrorCode:
    with pytest.raises(DgsError) as error:
        load_network(folder, name)
    return error.value.code


def test_round_trip_keeps_values_configuration_and_notes(model: Path) -> None:
    torch.manual_seed(0)
    wanted = DGSNet(PRESETS["tiny"]).state_dict()
    net, info = load_network(model, "net")
    assert not net.training
    assert (info.model_id, info.config, info.notes) == ("net", PRESETS["tiny"], {"step": 12})
    for key, value in net.state_dict().items():
        assert torch.equal(value, wanted[key].half().float()), key


def test_missing_files(model: Path) -> None:
    assert _code(model, "other") == ErrorCode.WEIGHTS_MISSING
    (model / "net.json").unlink()
    assert _code(model) == ErrorCode.WEIGHTS_MISSING


def test_one_flipped_bit_is_refused(model: Path) -> None:
    path = model / "net.pt"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert _code(model) == ErrorCode.WEIGHTS_ALTERED


def test_a_broken_description_is_refused(model: Path) -> None:
    sidecar = model / "net.json"
    values = json.loads(sidecar.read_text())
    for text in ("{", "[]", json.dumps({**values, "config": {"voxel_size": -1}})):
        sidecar.write_text(text)
        assert _code(model) == ErrorCode.WEIGHTS_ALTERED


def test_weights_of_another_shape_are_refused(model: Path) -> None:
    sidecar = model / "net.json"
    values = json.loads(sidecar.read_text())
    values["config"]["module_two_layers"] = 2
    sidecar.write_text(json.dumps(values))
    assert _code(model) == ErrorCode.WEIGHTS_ALTERED

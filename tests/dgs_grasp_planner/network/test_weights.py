"""Weights files: round trip, and refusal of missing and altered ones."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.network import PRESETS, DGSNet, load_network, save_network
from tests.support.refused import refused


@pytest.fixture
def model(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_network(DGSNet(PRESETS["tiny"]), tmp_path, "net", {"step": 12})
    return tmp_path


def test_round_trip_keeps_values_configuration_and_notes(model: Path) -> None:
    torch.manual_seed(0)
    wanted = DGSNet(PRESETS["tiny"]).state_dict()
    net, info = load_network(model, "net")
    assert not net.training
    assert (info.model_id, info.config, info.notes) == ("net", PRESETS["tiny"], {"step": 12})
    for key, value in net.state_dict().items():
        assert torch.equal(value, wanted[key].half().float()), key


def test_missing_files(model: Path) -> None:
    (model / "net.json").unlink()
    for name in ("other", "net"):
        with refused(ErrorCode.WEIGHTS_MISSING):
            load_network(model, name)


def test_one_flipped_bit_is_refused(model: Path) -> None:
    path = model / "net.pt"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with refused(ErrorCode.WEIGHTS_ALTERED, "has SHA-256"):
        load_network(model, "net")


def test_a_broken_description_or_one_of_another_shape_is_refused(model: Path) -> None:
    sidecar = model / "net.json"
    values = json.loads(sidecar.read_text())
    config = {**values["config"], "module_two_layers": 2}
    for text, words in (
        ("{", "no valid description"),
        ("[]", "no valid description"),
        (json.dumps({**values, "config": {"voxel_size": -1}}), "no valid description"),
        (json.dumps({**values, "config": config}), "does not fit"),
    ):
        sidecar.write_text(text)
        with refused(ErrorCode.WEIGHTS_ALTERED, words):
            load_network(model, "net")
    sidecar.write_text(json.dumps({**values, "hand": "another"}))
    with refused(ErrorCode.WRONG_HAND, "another"):
        load_network(model, "net")

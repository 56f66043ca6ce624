"""What weights were trained on, from the notes beside them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dgs_description.errors import DgsError
from dgs_grasp_planner.network import PRESETS, DGSNet, save_network
from dgs_grasp_planner.network.weights import file_sha256
from dgs_learning.evaluation.weights_history import history
from tests.dgs_grasp_planner.models import eager_network


def test_what_weights_have_seen_is_read_from_their_notes(tmp_path: Path) -> None:
    data = tmp_path / "data.npz"
    data.write_bytes(b"the present data")
    notes = {
        "step": 30,
        "training": {"batch": 4, "training_scenes": 48},
        "dataset": {"sha256": file_sha256(data)},
    }
    first = save_network(eager_network(), tmp_path, "first", notes)
    start = {"model_id": "first", "sha256": first.sha256, "step": 30}
    later = {**notes, "step": 10, "init": start, "dataset": {"sha256": "older"}}
    save_network(eager_network(1), tmp_path, "second", later)
    one = history(tmp_path / "first.pt", data)
    assert (one.views, one.scenes, str(one)) == (120, 48, "120 views of 48 scenes")
    two = history(tmp_path / "second", data, [tmp_path / "first.pt"])
    assert str(two) == "160 views of 48 scenes of an earlier dataset"
    assert one < two
    fixed = DGSNet(replace(PRESETS["tiny"], fixed_shapes=2))
    save_network(fixed, tmp_path, "fixed", notes)
    assert str(history(tmp_path / "fixed", data)) == "120 views of 48 scenes, 2 fixed shapes of the hand"
    few = {**notes, "training": {**notes["training"], "grasps_per_object": 7}}
    save_network(DGSNet(replace(PRESETS["tiny"], name="paper")), tmp_path, "printed", few)
    printed = "120 views of 48 scenes, 7 grasps an object, as the paper prints it"
    assert str(history(tmp_path / "printed", data)) == printed
    with pytest.raises(DgsError, match="began from first"):
        history(tmp_path / "second", data)
    save_network(eager_network(), tmp_path, "untold")
    with pytest.raises(DgsError, match="untold has no notes"):
        history(tmp_path / "untold", data)

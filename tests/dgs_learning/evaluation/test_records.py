"""The run folder: what is written is what is read, and a folder belongs to one setting."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_learning.evaluation.protocol import AttemptRecord, Item, SceneResult
from dgs_learning.evaluation.provenance import describe_catalogue
from dgs_learning.evaluation.records import claim, cloud_to_keep, load_cloud, load_scene, save_scene
from dgs_sim_bridge.render.object_model import find_catalogue


def test_a_scene_survives_the_file(tmp_path: Path) -> None:
    attempt = AttemptRecord(
        3, 0, "thing", "bowl", "slipped", 0.5, position=(0.1, 0.2, 0.3), rejected={"TABLE": 2}
    )
    made = SceneResult(3, 2, 0, (attempt,), (Item("thing", "bowl", "low", False, "glass"),))
    save_scene(tmp_path, made, "abc", [np.array([[0.1, -0.2, 0.05]])])
    result, revision = load_scene(tmp_path, 3)
    assert result == made
    assert revision == "abc"
    assert load_cloud(tmp_path, 3, 0) == pytest.approx(np.array([[0.1, -0.2, 0.05]]), abs=1e-4)
    assert load_cloud(tmp_path, 3, 1).shape == (0, 3)


def test_kept_clouds_are_fine_where_things_are_and_coarse_on_the_table() -> None:
    square = np.stack(np.meshgrid(*[np.arange(0.0, 0.2, 0.002)] * 2, [0.0, 0.05]), axis=-1).reshape(-1, 3)
    thing = cloud_to_keep(square.astype(np.float32))[:, 2] > 0.02
    assert 2000 < thing.sum() < 3000 and 80 < (~thing).sum() < 150


def test_a_folder_without_results_is_anybodys(tmp_path: Path) -> None:
    for seed in (1, 2, 2):
        claim(tmp_path, {"seed": seed, "area": (0.4, 0.8)})
    save_scene(tmp_path, SceneResult(0, 1, 0, ()), "abc", [])
    for other in ({"seed": 1}, {}, {"seed": 2, "protocol": "robot"}, {"seed": 2, "area": (0.8, 0.4)}):
        with pytest.raises(ValueError, match="another setting"):
            claim(tmp_path, other)
    claim(tmp_path, {"seed": 2, "area": (0.4, 0.8), "scenes": 5})


def test_another_catalogue_has_another_hash() -> None:
    objects = find_catalogue("novel")
    heavier = [replace(objects[0], mass=objects[0].mass * 2), *objects[1:]]
    assert describe_catalogue("a", objects)["sha256"] != describe_catalogue("a", heavier)["sha256"]

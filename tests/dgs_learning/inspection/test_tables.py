"""Counts of a dataset file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_learning.inspection.tables import NOT_TRIED, PAPER, as_text, coverage, describe
from dgs_learning.objects.catalogue import make_catalogue
from tests.dgs_learning.small_dataset import small_dataset


def test_counts_are_those_of_the_file() -> None:
    data = small_dataset()
    summary = describe(data)
    assert summary["objects"] == summary["object_scales"] == 2
    assert summary["stage1_grasps"] == len(data.grasps)
    assert summary["scenes"] == len(data.scenes) >= 1
    assert summary["scene_grasps"] == sum(len(s.instance) for s in data.scenes) > 0
    assert 0 < summary["scene_grasps_turned_by_symmetry"] < summary["scene_grasps"]
    for key in ("stage1_grasps", "scene_grasps"):
        assert sum(sum(row[key].values()) for row in summary["by_class"].values()) == summary[key]
    percents = [v for row in summary["by_class"].values() for v in row["scene_grasps_percent"].values()]
    assert sum(percents) == pytest.approx(100, abs=0.01)
    assert summary["by_class"]["bowl"]["objects"] == 0


def test_objects_in_scenes_are_counted_with_and_without_grasps() -> None:
    data = small_dataset()
    instances = sum(len(scene.objects) for scene in data.scenes)
    rows = coverage(data)
    assert sum(row["instances"] for row in rows.values()) == instances
    assert sum(row["graspable"] for row in rows.values()) == sum(len(set(s.instance)) for s in data.scenes)
    assert all(row["low_graspable"] <= row["low_instances"] <= row["instances"] for row in rows.values())
    flat = replace(data, objects=[replace(o, vertices=o.vertices * np.float32(0.1)) for o in data.objects])
    assert (describe(data)["low_object_scales"], describe(flat)["low_object_scales"]) == (0, 2)
    assert describe(flat)["low_object_scales_with_grasps"] == 2
    assert sum(row["low_instances"] for row in coverage(flat).values()) == instances
    bare = replace(data, scenes=[replace(s, instance=s.instance[:0], grasp=s.grasp[:0]) for s in data.scenes])
    assert all(row["graspable"] == 0 for row in coverage(bare).values())


def test_scales_of_one_object_count_once() -> None:
    data = small_dataset()
    twice = replace(data, objects=[data.objects[0], replace(data.objects[1], name="block_043@1.20")])
    summary = describe(twice)
    assert (summary["objects"], summary["object_scales"]) == (1, 2)


def test_objects_without_grasps_are_listed_with_the_reason() -> None:
    data = small_dataset()
    last = len(data.grasps)
    bare = replace(data, first=np.array([0, last, last]), scenes=[], trials=np.array([8, 0]))
    without = describe(bare)["without_grasps"]
    assert without["no candidate was free of collision and closed around it"] == ["can_056@1.00"]
    assert describe(replace(bare, trials=np.array([8, 5])))["without_grasps"][
        "no simulated candidate held"
    ] == ["can_056@1.00"]
    of_catalogue = describe(
        replace(bare, objects=[model.scaled(1.0) for model in make_catalogue("train")[:2]])
    )
    assert of_catalogue["object_scales_without_grasps"][NOT_TRIED] == 307 * 5 - 2
    assert NOT_TRIED not in of_catalogue["without_grasps"]
    assert "can_056@1.00" not in as_text(describe(bare)) and "without grasps: 1" in as_text(describe(bare))


def test_table_one_of_the_paper_adds_up() -> None:
    assert sum(sum(row) for row in PAPER.values()) == pytest.approx(99.6, abs=0.2)

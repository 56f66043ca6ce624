"""SR, CR, intervals, failures and diversity from made-up attempts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_learning.evaluation.metrics import diversity, losses, spread, summarise, wilson
from dgs_learning.evaluation.protocol import NO_GRASP, AttemptRecord, Item, SceneResult
from tests.dgs_learning.evaluation.report.test_page import attempt


def record(outcome: str, shape_class: str = "cuboid", k: int = 0) -> AttemptRecord:
    made = attempt(k, outcome)
    return replace(made, shape_class=shape_class) if made.executed else made


def test_wilson_agrees_with_published_values() -> None:
    assert wilson(8, 10) == pytest.approx((0.4901625, 0.9433178), abs=1e-5)
    assert wilson(0, 10) == pytest.approx((0.0, 0.2775328), abs=1e-5)
    assert wilson(0, 0) == (0.0, 1.0)


def test_rates_follow_the_papers_definitions() -> None:
    first = SceneResult(
        0, 4, 2, tuple(record(o, k=k) for k, o in enumerate(("success", "slipped", "success", NO_GRASP)))
    )
    second = SceneResult(1, 2, 2, (record("success", "bowl", 7), record("success", "stick", 8)))
    summary = summarise([first, second])
    assert (summary["attempts"], summary["successes"]) == (5, 4)
    assert summary["sr"] == pytest.approx(0.8)  # no grasp found is no attempt
    assert summary["cr_pooled"] == pytest.approx(4 / 6)
    assert (summary["sr_interval"], summary["cr_interval"]) == (wilson(4, 5), wilson(4, 6))
    assert summary["cr_scene_mean"] == pytest.approx((0.5 + 1.0) / 2)
    assert summary["per_class"]["cuboid"]["sr"] == pytest.approx(2 / 3)
    assert summary["per_class"]["sphere"] == {
        "attempts": 0,
        "successes": 0,
        "sr": 0.0,
        "sr_interval": (0.0, 1.0),
    }
    assert summary["failures"] == {
        "approach contact": 0, "missed": 0, "slipped": 1, "lost in lift": 0, NO_GRASP: 1,
    }  # fmt: skip
    assert summary["time_s"]["stages"] == {"network": pytest.approx(5 * 0.2 / 6)}


def test_materials_are_counted_apart_where_there_is_glass() -> None:
    box, jar = Item("box", "cuboid", "upright", True), Item("jar", "cylinder", "upright", False, "glass")
    tried = (replace(record("success"), item=0), replace(record("missed", "cylinder"), item=1))
    assert "per_material" not in summarise([SceneResult(0, 1, 1, tried[:1], (box,))])
    rows = summarise([SceneResult(0, 2, 1, tried, (box, jar))])["per_material"]
    assert list(rows) == ["opaque", "glass"]
    assert [(m["cr_pooled"], m["sr"], m["objects"]) for m in rows.values()] == [(1.0, 1.0, 1), (0.0, 0.0, 1)]
    jars = summarise([SceneResult(0, 1, 0, (replace(tried[1], item=0),), (jar,))])["per_material"]
    assert jars["glass"]["objects"] == 1, "nothing but glass is to be told, too"


def test_kinds_of_rest_penetration_and_times_are_counted_apart() -> None:
    items = tuple(
        Item(kind, "bowl", kind, cleared)
        for kind, cleared in (("fits", True), ("wide", False), ("low", True))
    )
    numbers = ("item", "source", "cpu_seconds", "pd_mm", "pv_mm3", "pd_closed_mm", "pv_closed_mm3")
    tried = [
        ("success", 0, "level_pinch", 0.1, 1.0, 10.0, 3.0, 30.0),
        ("pushed", 1, "push", 0.1, 9.0, 90.0, 9.0, 90.0),
        ("slipped", 1, "dgs_net", 0.4, 4.0, 40.0, 5.0, 50.0),
        ("missed", 1, "level_pinch", 0.1, 2.0, 20.0, 7.0, 70.0),
        ("success", 2, "level_pinch", 0.3, 0.0, 0.0, 1.0, 10.0),
    ]
    attempts = tuple(
        replace(record(outcome, k=k), **dict(zip(numbers, row, strict=True)))
        for k, (outcome, *row) in enumerate(tried)
    )
    summary = summarise([SceneResult(0, 3, 2, attempts, items)])
    kinds = {
        kind: (part["successes"], part["attempts"], part["cleared"], part["objects"], part["pd_mm"]["mean"])
        for kind, part in summary["per_kind"].items()
    }
    assert kinds == {"fits": (1, 1, 1, 1, 1.0), "low": (1, 1, 1, 1, 0.0), "wide": (0, 2, 0, 1, 3.0)}
    assert summary["per_kind"]["wide"]["pv_mm3"]["mean"] == 30.0, "a push is no attempt"
    means = {name: summary[name]["mean"] for name in numbers[3:]}
    assert means == {"pd_mm": 1.75, "pv_mm3": 17.5, "pd_closed_mm": 4.0, "pv_closed_mm3": 40.0}
    assert (summary["level_pinches"]["successes"], summary["level_pinches"]["attempts"]) == (2, 3)
    assert summary["time_s"]["cpu_mean"] == pytest.approx(0.2)


def test_what_was_left_most_often_is_lost_most_then_what_failed_most() -> None:
    """Objects by name: how often cleared and failed in each of two scenes."""
    shown = {"d": ((1, 1),), "a": ((1, 1),), "easy": ((1, 0),), "b": ((0, 1), (1, 0)), "c": ((0, 3),)}
    scenes = []
    for number in range(2):
        there = [(name, each[number]) for name, each in shown.items() if number < len(each)]
        items = tuple(Item(name, "bowl", ("low", "wide")[number], bool(one[0])) for name, one in there)
        ends = [(k, "missed") for k, (_, one) in enumerate(there) for _ in range(one[1])]
        attempts = tuple(replace(record(end, k=n), item=k) for n, (k, end) in enumerate(ends))
        scenes.append(SceneResult(number, len(items), 0, attempts, items))
    rows = losses(scenes)
    assert [(row["object"], row["left"], row["failed"]) for row in rows] == [
        ("c", 1, 3), ("b", 1, 1), ("a", 0, 1), ("d", 0, 1),
    ]  # fmt: skip
    assert (rows[1]["shown"], rows[1]["kinds"]) == (2, {"low": 1, "wide": 1})


def test_a_run_without_a_single_grasp_has_a_summary() -> None:
    summary = summarise([SceneResult(0, 3, 0, (record(NO_GRASP), record(NO_GRASP, k=1)))])
    assert (summary["sr"], summary["cr_pooled"], summary["diversity"]) == (0.0, 0.0, None)
    assert summary["pd_mm"] == {}


def test_a_scene_from_which_everything_rolled_away_counts_nothing() -> None:
    lifted, empty = SceneResult(0, 1, 1, (record("success"),)), SceneResult(1, 0, 0, ())
    assert [summarise([lifted, empty])[key] for key in ("cr_pooled", "cr_scene_mean")] == [1.0, 1.0]
    assert summarise([empty])["cr_scene_mean"] == 0.0


def test_spread_counts_deep_penetrations() -> None:
    row = spread([0.0, 1.0, 2.0, 5.0], deep=2.0)
    assert row["mean"] == pytest.approx(2.0)
    assert row["variance"] == pytest.approx(3.5)
    assert row["median"] == pytest.approx(1.5)
    assert row["p95"] == pytest.approx(4.55)
    assert row["share_over_2"] == pytest.approx(0.25)


def test_diversity_is_the_share_of_the_first_principal_component() -> None:
    count = 4000
    rng = np.random.default_rng(0)
    still = np.tile(np.eye(3), (count, 1, 1))
    joints = np.zeros((count, 20))
    position = np.zeros((count, 3))
    position[:, 0] = rng.normal(size=count)
    assert diversity(position, still, joints, joints) == pytest.approx(1.0)
    position[:, 1] = rng.normal(size=count)
    joints[:, 4] = rng.normal(size=count)
    # Three directions: x, y, and joint 4 of both shapes together, which has twice the variance.
    assert diversity(position, still, joints, joints) == pytest.approx(0.5, abs=0.02)
    turned = Rotation.from_euler("z", rng.uniform(-1, 1, (count, 1))).as_matrix()
    assert diversity(0 * position, turned, 0 * joints, 0 * joints) == pytest.approx(1.0)


def test_diversity_of_one_grasp_is_undefined() -> None:
    assert np.isnan(diversity(np.zeros((1, 3)), np.eye(3)[None], np.zeros((1, 20)), np.zeros((1, 20))))

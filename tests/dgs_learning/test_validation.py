"""Stored grasps simulated again: what is drawn, what is refused, what an interrupted run keeps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_learning import validation
from dgs_learning.dataset import load_dataset, save_dataset
from dgs_learning.evaluation.report.templates import render
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.trial import RULES
from dgs_learning.validation import check_alone, draw, of_kind, validate
from tests.dgs_learning.small_dataset import small_dataset, small_dataset_file
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.commands import dgs
from tests.support.refused import refused


def test_a_larger_draw_contains_the_smaller_and_seeds_differ() -> None:
    every = np.ones(1000, dtype=bool)
    assert draw(every, 50, 3, 1) == draw(every, 80, 3, 1)[:50]
    assert draw(every, 50, 3, 1) != draw(every, 50, 4, 1)
    assert draw(every, 50, 3, 1) != draw(every, 50, 3, 2)
    assert sorted(draw(every[:5], 99, 0, 1)) == [0, 1, 2, 3, 4]


def test_stored_grasps_hold_again_in_other_poses(tmp_path: Path) -> None:
    summary = validate(small_dataset_file(), 1, 6, 0, Engine(1), tmp_path)
    assert summary["tried"] == min(6, len(small_dataset().grasps))
    assert summary["passed"] >= 0.7 * summary["tried"]
    assert 0 <= summary["penetration_mm"]["mean"] <= summary["penetration_mm"]["p95"] + 1e-9 < 2.2
    assert sum(row["tried"] for row in summary["by_class"].values()) == summary["tried"]
    assert f"{summary['passed']} of {summary['tried']} passed" in render("validation.txt", m=summary)


def test_scene_grasps_lift_their_object(tmp_path: Path) -> None:
    summary = validate(small_dataset_file(), 2, 4, 0, Engine(1), tmp_path)
    assert summary["tried"] == 4
    assert summary["passed"] >= 2
    assert sum(summary["ends"].values()) == 4
    assert summary["ends"].get("lifted", 0) == summary["passed"]


def test_hands_beside_their_object_do_not_hold_and_hands_in_it_penetrate(tmp_path: Path) -> None:
    data, file = small_dataset(), tmp_path / "moved.npz"
    save_dataset(file, replace(data, grasps=replace(data.grasps, position=data.grasps.position + 0.2)))
    assert validate(file, 1, 4, 0, Engine(1), tmp_path)["passed"] == 0
    save_dataset(file, replace(data, grasps=replace(data.grasps, position=np.zeros((len(data.grasps), 3)))))
    assert validate(file, 1, 3, 0, Engine(1), tmp_path)["penetration_mm"]["mean"] > 1


def test_what_is_in_its_object_too_deep_is_not_said_to_have_fallen(monkeypatch: pytest.MonkeyPatch) -> None:
    data = small_dataset()
    inside = replace(data.grasps[0], position=np.zeros(3))
    monkeypatch.setitem(RULES, "shallow", replace(RULES["paper"], max_depth=0.001))
    check = check_alone(0, data.objects[data.owner[0]], inside, [0], "pybullet", None, "shallow")
    assert (check.how, check.passed) == ("penetration", False)


def test_finished_checks_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(validation, "revision", lambda: "committed")
    first = validate(small_dataset_file(), 1, 2, 0, Engine(1), tmp_path)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("output.pkl")}
    more = validate(small_dataset_file(), 1, 3, 0, Engine(1), tmp_path)
    after = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("output.pkl")}
    assert len(kept) == first["tried"] == 2 and kept.items() <= after.items() and len(after) == 3
    assert first["passed"] <= more["passed"] <= first["passed"] + 1


def test_checks_of_another_revision_are_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for made_by in ("first", "second", "uncommitted+", "uncommitted+"):
        monkeypatch.setattr(validation, "revision", lambda made_by=made_by: made_by)
        assert validate(small_dataset_file(), 1, 1, 0, Engine(1), tmp_path)["revision"] == made_by
    assert len(list(tmp_path.rglob("output.pkl"))) == 2


def test_draw_among_a_class_or_a_number_of_fingers_only() -> None:
    data = small_dataset()
    name = data.objects[0].shape_class
    marked = of_kind(data, 1, [name], [2])
    owner = np.repeat([model.shape_class for model in data.objects], np.diff(data.first))
    assert (marked == ((owner == name) | (data.fingers == 2))).all() and not marked.all()
    assert of_kind(data, 1, [], []).all()
    scene_rows = of_kind(data, 2, [name], [])
    assert scene_rows.sum() == sum(
        data.objects[scene.objects[i]].shape_class == name for scene in data.scenes for i in scene.instance
    )
    drawn = draw(marked, len(marked), 0, 1)
    assert sorted(drawn) == np.flatnonzero(marked).tolist()


def test_command_drops_what_failed(tmp_path: Path) -> None:
    data = small_dataset()
    file, kept = tmp_path / "some_open.npz", tmp_path / "kept.npz"
    data.grasps.position[0] += 0.1  # beside the object
    save_dataset(file, data)
    number = int(np.flatnonzero(of_kind(data, 1, [data.objects[0].shape_class], [])).size)
    words = [
        "validate",
        "--count",
        str(number),
        "--shape-class",
        data.objects[0].shape_class,
        "--workers",
        "1",
    ]
    words += ["--folder", str(tmp_path), "--dataset", str(file), "--drop", str(kept)]
    result = dgs(words)
    (dropped,) = (int(line.split()[0]) for line in result.output.splitlines() if "dropped" in line)
    assert dropped >= 1
    rest = load_dataset(kept)
    assert len(rest.grasps) == len(data.grasps) - dropped
    assert not (np.abs(rest.grasps.grasp_joints).max(1) == 0).any()


def test_command_writes_json(tmp_path: Path) -> None:
    words = ["validate", "--stage", "1", "--count", "1", "--workers", "1", "--folder", str(tmp_path)]
    out = tmp_path / "v.json"
    dgs([*words, "--dataset", str(small_dataset_file()), "--json", str(out)])
    written = json.loads(out.read_text())
    assert {"tried", "passed", "penetration_mm", "seed", "revision", "stage"} <= written.keys()


def test_no_third_stage(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no stage 3"):
        validate(small_dataset_file(), 3, 1, 0, Engine(1), tmp_path)


def test_a_file_without_such_grasps_is_refused_by_what_was_asked(tmp_path: Path) -> None:
    file = tmp_path / "no_scenes.npz"
    save_dataset(file, replace(tiny_dataset(), scenes=[]))
    for stage, fingers, words in (
        (2, (), "has no grasps of stage 2$"),
        (1, (7,), "stage 1 of the classes and"),
    ):
        with refused(ErrorCode.REQUEST_INVALID, words):
            validate(file, stage, 1, 0, Engine(1), tmp_path, fingers=fingers)

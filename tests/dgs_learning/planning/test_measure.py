"""A run goes on where it was stopped, and the sums are right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dgs_description.grasp import GraspSet
from dgs_learning.evaluation.report.templates import render
from dgs_learning.planning.cases import PickCase
from dgs_learning.planning.measure import load_records, measure_missing, summarise
from tests.dgs_learning.planning.cells import PLACE, TARGET, grasps_at, record


def test_a_run_that_was_stopped_goes_on_with_the_scenes_that_are_left(tmp_path: Path) -> None:
    assert load_records(tmp_path) == []
    (tmp_path / "scene_0001.json").write_text('{"scene": 1, "candidates": 7}')
    (tmp_path / "scene_0000.partial").write_text('{"scene": 0, "candi')
    made: list[int] = []

    def case_of(number: int) -> PickCase:
        made.append(number)
        return PickCase(number, (), np.zeros((0, 3), np.float32), GraspSet.empty())

    measure_missing(tmp_path, range(3), case_of)
    assert made == [0, 2]
    assert [(record["scene"], record["candidates"]) for record in load_records(tmp_path)] == [
        (0, 0),
        (1, 7),
        (2, 0),
    ]


def test_a_scene_is_measured_whole(tmp_path: Path) -> None:
    grasps = grasps_at((0.9, 0.0, -0.09), (*PLACE, -0.09))
    measure_missing(tmp_path, [4], lambda k: PickCase(k, (TARGET,), np.zeros((0, 3), np.float32), grasps))
    (found,) = load_records(tmp_path)
    assert found["plan"]["index"] == found["best_reachable"] == 1
    assert found["plan"]["rejections"] == {"OUT_OF_REACH": 1} and found["plan"]["score_given_up"] == 0.0
    assert found["baseline"]["whole_pick"]["index"] == 1 and found["plan"]["processor_ms"] > 0
    assert found["check"]["states"] > 1000 and found["check"]["collisions"] == {}
    assert summarise([found])["share_as_good"] == 1.0


def test_summary_counts_what_it_says() -> None:
    hit = {"carry: carried object - object cup_3": [4, 0.002]}
    measured = summarise(
        [
            {"scene": 0, "candidates": 0},
            record(1, 0, 0),
            record(2, 3, 1, hit),
            record(3, None, 5),
            record(4, None, None),
        ]
    )
    assert measured["scenes"] == 5 and measured["scenes_without_candidates"] == 1
    assert measured["reachable_scenes"] == 3 and measured["found"] == 2
    assert measured["share_found"] == pytest.approx(2 / 3, abs=1e-3)
    assert measured["share_as_good"] == pytest.approx(1 / 3, abs=1e-3)
    assert measured["rejected_candidates"] == {"OUT_OF_REACH": 10}
    assert measured["planning"]["processor_ms"]["median"] == 12.5
    assert measured["check"]["picks"] == 2 and measured["check"]["picks_with_collision"] == 1
    assert measured["check"]["collisions"] == {"carry: carried object - object": 1}
    assert measured["check"]["deepest_mm"] == 2.0 and measured["check"]["velocity_violations"] == 3
    about = {"command": "", "date": "", "machine": {"processor": "", "load_average": 0.0, "cores": 1}}
    assert "| 2, 200 |" in render("planning.md", m=measured | about)

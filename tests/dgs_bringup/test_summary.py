"""Figures of a run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from dgs_bringup.summary import Attempt, Refusals, RunSummary, git_revision, summary_table
from dgs_description.errors import ErrorCode

RECORDS = [
    Attempt(0.9, True, 0, "placed", {"predict": 1.0, "lift": 2.0}),
    Attempt(0.8, False, ErrorCode.NOTHING_HELD, "slipped", {"predict": 1.5}),
    Attempt(0.8, False, ErrorCode.NOTHING_HELD, "slipped", {"predict": 0.5}, source="level_pinch"),
]
RUN = RunSummary(
    seed=3,
    objects=5,
    cleared=1,
    records=RECORDS,
    total_seconds=30.0,
    simulated_seconds=60.0,
    refusals=["none of 3"],
    error_code=0,
    message="done",
    revision="abc",
    model="dgs_net 123",
    places={"cup": "bin"},
)


def test_rates_and_seconds():
    data = RUN.to_json()
    assert (data["objects"], data["attempts"], data["successes"], data["cleared"]) == (5, 3, 1, 1)
    assert (data["sr"], data["cr"]) == (0.3333, 0.2)
    assert data["seconds"] == {"total": 30.0, "predict": 3.0, "lift": 2.0}
    assert data["records"][2]["source"] == "level_pinch"
    assert json.loads(json.dumps(data)) == data
    assert summary_table(data).row_count == 6


def test_an_attempt_cut_off_by_the_time_limit_is_not_counted():
    cut_off = Attempt(0.9, False, ErrorCode.EXECUTION_CANCELLED, "cancelled", {})
    data = replace(RUN, records=[*RECORDS, cut_off]).to_json()
    assert (data["attempts"], data["sr"], len(data["records"])) == (3, 0.3333, 4)


def test_no_attempts_are_no_division_by_zero():
    data = replace(RUN, records=[], objects=0, cleared=0).to_json()
    assert (data["sr"], data["cr"]) == (0.0, 0.0)
    assert summary_table(data).row_count == 4


def test_only_looks_without_an_attempt_are_refused_ones():
    refusals = Refusals()
    for stage, message in (
        ("capture", ""), ("rejected", "none of 32"), ("rejected", "none of 5"), ("capture", ""),
        ("rejected", "none of 3"),
        ("recorded", "attempt 1"), ("capture", ""), ("rejected", "none of 2"),
    ):  # fmt: skip
        refusals.add(stage, message)
    assert refusals.ended() == ["none of 32; none of 5", "none of 2"]


def test_revision_outside_a_checkout(tmp_path: Path):
    assert git_revision(tmp_path) == "unknown"

"""Figures of a run."""

from __future__ import annotations

import json
from pathlib import Path

from dgs_bringup.summary import Attempt, Refusals, RunSummary, git_revision
from dgs_description.errors import ErrorCode


def summary(**changes: object) -> RunSummary:
    records = (
        Attempt(0.9, True, 0, "placed", {"predict": 1.0, "lift": 2.0}),
        Attempt(0.8, False, ErrorCode.NOTHING_HELD, "slipped", {"predict": 1.5}),
        Attempt(0.8, False, ErrorCode.NOTHING_HELD, "slipped", {"predict": 0.5}),
    )
    values = {
        "seed": 3,
        "objects": 5,
        "cleared": 1,
        "records": records,
        "total_seconds": 30.0,
        "error_code": 0,
        "message": "done",
        "revision": "abc",
    }
    return RunSummary(**{**values, **changes})


def test_rates_and_seconds():
    run = summary()
    assert (run.successes, round(run.sr, 3), run.cr) == (1, 0.333, 0.2)
    assert run.seconds == {"total": 30.0, "predict": 3.0, "lift": 2.0}


def test_an_attempt_cut_off_by_the_time_limit_is_not_counted():
    cut_off = Attempt(0.9, False, ErrorCode.EXECUTION_CANCELLED, "cancelled", {})
    assert summary(records=(*summary().records, cut_off)).sr == summary().sr


def test_no_attempts_are_no_division_by_zero():
    run = summary(records=(), objects=0, cleared=0)
    assert (run.sr, run.cr) == (0.0, 0.0)


def test_the_file_has_the_keys_that_others_read(tmp_path: Path):
    summary().write(tmp_path / "summary.json")
    data = json.loads((tmp_path / "summary.json").read_text())
    assert {
        "objects",
        "attempts",
        "successes",
        "cleared",
        "sr",
        "cr",
        "seconds",
        "seed",
        "revision",
        "records",
    } <= set(data)
    assert (data["objects"], data["attempts"], data["successes"], data["cleared"]) == (5, 3, 1, 1)


def test_only_looks_without_an_attempt_are_refused_ones():
    refusals = Refusals()
    for stage, message in (
        ("capture", ""), ("rejected", "none of 32"), ("rejected", "none of 5"), ("capture", ""),
        ("rejected", "none of 3"),
        ("recorded", "attempt 1"), ("capture", ""), ("rejected", "none of 2"),
    ):  # fmt: skip
        refusals.add(stage, message)
    assert refusals.ended() == ("none of 32; none of 5", "none of 2")


def test_revision_outside_a_checkout(tmp_path: Path):
    assert git_revision(tmp_path) == "unknown"

"""Figures of a run."""

from __future__ import annotations

import json
from typing import Any

from dgs_interfaces.msg import PickRecord, StageTime

from dgs_bringup.summary import refused_looks, summarise, summary_table, true_records
from dgs_description.errors import ErrorCode


def record(success: bool, code: int, seconds: dict[str, float]) -> dict[str, Any]:
    return {
        "score": 0.9,
        "success": success,
        "code": code,
        "message": "",
        "seconds": seconds,
        "source": "dgs_net",
    }


MISSED = ErrorCode.NOTHING_HELD
RECORDS = [
    record(True, 0, {"predict": 1.0, "lift": 2.0}),
    record(False, MISSED, {"predict": 1.5}),
    record(False, MISSED, {"predict": 0.5}),
]
PLACES = {"cup": "bin", "pen": "table", "box": "table", "can": "floor", "ball": "held"}


def test_rates_and_seconds():
    data = summarise(RECORDS, PLACES, 30.0, seed=3)
    assert (data["objects"], data["attempts"], data["successes"], data["cleared"]) == (5, 3, 1, 1)
    assert (data["sr"], data["cr"], data["seed"]) == (0.3333, 0.2, 3)
    assert data["seconds"] == {"total": 30.0, "predict": 3.0, "lift": 2.0}
    assert json.loads(json.dumps(data)) == data
    assert summary_table(data).row_count == 6


def test_an_attempt_cut_off_by_the_time_limit_is_not_counted():
    cut_off = record(False, ErrorCode.EXECUTION_CANCELLED, {"predict": 1.0})
    data = summarise([*RECORDS, cut_off], PLACES, 30.0)
    assert (data["attempts"], data["sr"], len(data["records"])) == (3, 0.3333, 4)
    assert data["seconds"]["predict"] == 4.0, "its time is"


def test_no_attempts_are_no_division_by_zero():
    data = summarise([], {}, 1.0)
    assert (data["sr"], data["cr"]) == (0.0, 0.0)
    assert summary_table(data).row_count == 4


def test_only_looks_without_an_attempt_are_refused_ones():
    feedback = [
        ("capture", ""), ("rejected", "none of 32"), ("rejected", "none of 5"), ("capture", ""),
        ("rejected", "none of 3"),
        ("recorded", "attempt 1"), ("capture", ""), ("rejected", "none of 2"),
    ]  # fmt: skip
    assert refused_looks(feedback) == ["none of 32; none of 5", "none of 2"]


def test_what_really_happened_belongs_to_the_grasps_also_where_pushes_were_between():
    records = [
        PickRecord(
            attempt=k, source="edge_pinch", success=False, stage_times=[StageTime(stage="lift", seconds=1.5)]
        )
        for k in (1, 2, 3)
    ]
    outcomes = {1: True}
    for attempt, outcome in ((2, False), (2, False), (2, True)):  # two pushes, then the grasp
        outcomes[attempt] = outcome
    told = true_records(records, outcomes)
    assert [one["success"] for one in told] == [True, True, False]
    assert told[0]["seconds"] == {"lift": 1.5} and told[0]["source"] == "edge_pinch"

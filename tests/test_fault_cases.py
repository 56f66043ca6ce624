"""Expected ends of the fault trials, and how a trial is judged."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dgs_description.errors import ErrorCode
from tests.support.fault_cases import ARM_STAGES, STAGES, Case, Outcome, all_cases, document_table, table

CASE = Case("cancel", "transfer")
RIGHT = Outcome(
    CASE,
    reached=True,
    code=ErrorCode.EXECUTION_CANCELLED,
    answered=0.4,
    settled=1.0,
    stood=True,
    truthful=True,
    home=0,
    next_pick=0,
)


def test_every_fault_strikes_every_stage_it_can() -> None:
    cases = all_cases()
    assert len(set(cases)) == len(cases)
    assert {c.stage for c in cases if c.fault == "cancel"} == set(STAGES)
    assert {c.stage for c in cases if c.fault == "abort_arm_goal"} == set(ARM_STAGES)
    assert {c.fault for c in cases} >= {
        "protective_stop",
        "emergency_stop",
        "drop_joint_states",
        "jam_finger",
    }
    assert all(case.codes for case in cases)


def test_the_hand_holds_while_it_carries_and_opens_otherwise() -> None:
    assert {stage: Case("cancel", stage).hand for stage in ("close", "lift", "carry", "release", "home")} == {
        "close": "open",
        "lift": "holds",
        "carry": "holds",
        "release": "open",
        "home": "open",
    }
    assert Case("protective_stop", "close").hand == "any" and Case("protective_stop", "close").latches


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"reached": False}, "reached"),
        ({"code": 0}, "code"),
        ({"answered": 2.1}, "answered"),
        ({"settled": None}, "end state"),
        ({"stood": False}, "moved"),
        ({"truthful": False}, "untrue"),
        ({"home": 208}, "/go_home"),
        ({"next_pick": 213, "next_message": "no path"}, "next pick ended with 213 no path"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, object], word: str) -> None:
    assert RIGHT.problems() == []
    (problem,) = replace(RIGHT, **change).problems()  # type: ignore[arg-type]
    assert word in problem


def test_table_counts_by_fault() -> None:
    wrong = replace(RIGHT, case=Case("cancel", "lift"), settled=3.5)
    other = replace(RIGHT, case=Case("stop", "lift"), code=ErrorCode.STOPPED)
    first, second = table([RIGHT, wrong, other])
    assert (first["fault"], first["trials"], first["right"]) == ("cancel", 2, 1)
    assert first["stages"] == ["transfer", "lift"] and first["slowest_end_state_s"] == 3.5
    assert first["problems"] == ["lift: end state after 3.5 s"]
    assert (second["fault"], second["right"], second["problems"]) == ("stop", 1, [])


def test_the_table_of_the_document_names_counts_times_and_what_was_wrong() -> None:
    report = {
        "date": "2026-01-31", "seed": 3, "trials": 2, "right": 1,
        "faults": table([RIGHT, replace(RIGHT, case=Case("cancel", "lift"), settled=3.5)]),
        "freeze_camera": {
            "diagnosed_wall_seconds": 2.6, "code": 508, "wall_seconds": 20.2, "next_run": 502, "right": True
        },  # fmt: skip
    }  # fmt: skip
    text = document_table(report)
    assert "| cancel | transfer, lift | 2 | 1 | 0.40, 3.50 | lift: end state after 3.5 s |" in text
    assert "508 after 20.2 s" in text and "1 of 2 trials right, measured 2026-01-31, scene seed 3." in text

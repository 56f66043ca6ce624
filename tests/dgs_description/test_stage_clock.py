"""Stages add up to the whole, also where one lies within another."""

from __future__ import annotations

from dgs_description.stage_clock import StageClock


def test_a_stage_within_a_stage_counts_for_itself() -> None:
    now = iter(range(100))
    clock = StageClock(lambda: float(next(now)))  # made at 0
    with clock("outer"):  # 1 ... 6
        with clock("inner"):  # 2 ... 3
            pass
        with clock("inner"):  # 4 ... 5
            pass
    with clock("outer"):  # 7 ... 8
        pass
    assert clock.times == {"inner": 2.0, "outer": 4.0}
    assert clock.finish() == {"inner": 2.0, "outer": 4.0, "total": 9.0}


def test_a_stage_that_fails_is_timed_too() -> None:
    clock = StageClock()
    try:
        with clock("broken"):
            raise ValueError
    except ValueError:
        pass
    assert list(clock.times) == ["broken"]

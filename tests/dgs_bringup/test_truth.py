"""Ground truth of a run: what counts as lifted and as cleared."""

from __future__ import annotations

from dgs_bringup.truth import TruthTracker

NAMES = ["cup", "pen"]


def test_an_object_held_long_enough_makes_the_attempt_a_success_even_if_it_falls_later():
    truth = TruthTracker(hold_time=0.5)
    truth.update(0.0, NAMES, ["table", "table"])
    for time in (1.0, 1.3, 1.6):
        truth.update(time, NAMES, ["held", "table"])
    truth.update(2.0, NAMES, ["floor", "table"])
    assert truth.end_attempt()
    assert truth.cleared == 0
    assert not truth.end_attempt()


def test_a_touch_in_the_air_is_no_lift():
    truth = TruthTracker(hold_time=0.5)
    for time, place in ((0.0, "held"), (0.4, "table"), (0.6, "held"), (0.9, "table")):
        truth.update(time, NAMES, [place, "table"])
    assert not truth.end_attempt()


def test_an_object_that_comes_into_the_bin_counts_once():
    truth = TruthTracker()
    truth.update(0.0, NAMES, ["bin", "table"])
    assert truth.end_attempt()
    truth.update(1.0, NAMES, ["bin", "table"])
    assert not truth.end_attempt()
    truth.update(2.0, NAMES, ["bin", "bin"])
    assert truth.end_attempt()
    assert (truth.cleared, truth.objects) == (2, 2)

"""Ground truth of a run: what counts as lifted and as cleared."""

from __future__ import annotations

from dgs_bringup.truth import TruthTracker

NAMES = ["cup", "pen"]


def test_an_object_held_long_enough_makes_the_attempt_a_success_even_if_it_falls_later():
    truth = TruthTracker()
    truth.update(0.0, NAMES, ["table", "table"])
    for time in (1.0, 1.3, 1.6):
        truth.update(time, NAMES, ["held", "table"])
    truth.update(2.0, NAMES, ["floor", "table"])
    assert truth.end_attempt()
    assert truth.places["cup"] == "floor"
    assert not truth.end_attempt()


def test_a_touch_in_the_air_is_no_lift():
    truth = TruthTracker()
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
    assert truth.places == {"cup": "bin", "pen": "bin"}


def test_an_object_left_in_the_hand_counts_for_the_attempt_that_lifted_it():
    """A fault on the way: the task records the attempt, and brings the object home or loses it before the next one."""
    for later in ("bin", "table"):
        truth = TruthTracker()
        for time in (0.0, 1.0):
            truth.update(time, NAMES, ["held", "table"])
        assert truth.end_attempt()
        truth.update(2.0, NAMES, ["held", "table"])
        for time in (3.0, 3.6):
            truth.update(time, NAMES, [later, "table"])
        assert not truth.end_attempt()
    # From the table it may be lifted once more.
    for time, place in ((4.0, "held"), (5.0, "held"), (6.0, "table")):
        truth.update(time, NAMES, [place, "table"])
    assert truth.end_attempt()


def test_an_object_that_falls_into_the_bin_while_the_next_attempt_begins_is_not_that_one_s():
    truth = TruthTracker()
    for time in (0.0, 1.0):
        truth.update(time, NAMES, ["held", "table"])
    assert truth.end_attempt()
    # It slips, is held again, and falls into the bin.
    for time, place in ((1.2, "table"), (1.4, "held"), (1.8, "table"), (2.0, "bin")):
        truth.update(time, NAMES, [place, "table"])
    assert not truth.end_attempt()

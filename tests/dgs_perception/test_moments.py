"""Messages of the same moment find one another."""

from __future__ import annotations

from dgs_perception.moments import KEPT, Moments


def test_one_topic_needs_no_other() -> None:
    moments = Moments(["depth"])
    assert moments.add("depth", 1, "a") == {"depth": "a"}


def test_a_moment_is_whole_in_any_order_and_is_given_once() -> None:
    moments = Moments(["left", "right"])
    assert moments.add("right", 2, "r2") is None
    assert moments.add("left", 1, "l1") is None
    assert moments.add("left", 2, "l2") == {"left": "l2", "right": "r2"}
    # Its other half is forgotten: it is older than what was given.
    assert moments.add("right", 1, "r1") is None


def test_what_never_becomes_whole_is_forgotten() -> None:
    moments = Moments(["left", "right"])
    for stamp in range(100):
        assert moments.add("left", stamp, stamp) is None
    assert len(moments._started) == KEPT
    assert moments.add("right", 99, "r") == {"left": 99, "right": "r"}


def test_stamps_may_jump_back() -> None:
    moments = Moments(["left", "right"])
    for stamp in range(100, 100 + KEPT):
        moments.add("left", stamp, "before")
    moments.add("left", 1, "l")
    assert moments.add("right", 1, "r") == {"left": "l", "right": "r"}

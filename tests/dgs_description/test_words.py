"""Words of sentences."""

from __future__ import annotations

from dgs_description.words import plural, shortened


def test_one_is_singular() -> None:
    assert [plural(count, "grasp") for count in (0, 1, 2)] == ["0 grasps", "1 grasp", "2 grasps"]


def test_what_is_too_long_keeps_begin_and_end() -> None:
    assert shortened("short", 5) == "short"
    text = shortened("begin" + 10**6 * "x" + "end")
    assert text.startswith("begin") and text.endswith("end") and len(text) < 1100

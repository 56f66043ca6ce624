"""Words of sentences."""

from __future__ import annotations

from dgs_description.words import plural


def test_one_is_singular() -> None:
    assert [plural(count, "grasp") for count in (0, 1, 2)] == ["0 grasps", "1 grasp", "2 grasps"]

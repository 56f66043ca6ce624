"""What `dgs bench-synthesis` measures: times that add up, views of the right size."""

from __future__ import annotations

import pytest

from dgs_learning.evaluation.report.templates import render
from dgs_learning.synthesis import measure, stage_one
from tests.dgs_learning.small_dataset import small_dataset


def test_views_have_twenty_thousand_points_with_the_table() -> None:
    result = measure.measure_views(small_dataset(), 2)
    assert result["with_table"]["points"] == 20_000
    assert 0 < result["near_objects"]["points"] < 20_000
    assert all(row["median_ms"] > 0 for row in result.values())


@pytest.fixture(scope="module")
def rate() -> dict:
    """One chunk on the smallest amount of work: the first sphere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "SHAPE_CLASSES", ("sphere",))
        patch.setattr(stage_one, "MAX_RESTING_POSES", 1)
        return measure.measure_grasps(1, 3)


def test_stages_add_up_to_the_whole(rate: dict) -> None:
    stages = {
        "distance grid",
        "resting poses",
        "draw",
        "kinematics",
        "world",
        "closing",
        "gravity",
        "recheck",
        "second engine",
    }
    assert set(rate["stage_ms_per_trial"]) == stages
    assert rate["trials"] == 3 and rate["grasps"] <= 3
    total = sum(rate["stage_ms_per_trial"].values()) * rate["trials"] / 1e3
    assert total == pytest.approx(rate["cpu_seconds"], rel=0.1)
    assert rate["grasps_per_core_second"] == pytest.approx(rate["grasps"] / rate["cpu_seconds"], abs=0.01)


def test_lines_say_the_rate(rate: dict) -> None:
    view = {"median_ms": 70.0, "points": 20_000.0}
    measured = {"stage1": rate, "views": {"with_table": view}}
    text = render("synthesis.txt", m=measured).splitlines()
    assert f"{rate['grasps_per_core_second']:.2f} validated grasps per core" in text[0]

"""`dgs bench-inference`: what it writes, and its scene."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dgs_grasp_planner.preprocess import MAX_POINTS, prepare_rows
from dgs_learning.cli.bench_scene import bench_scene
from tests.dgs_grasp_planner.models import save_eager_model
from tests.support.commands import dgs


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, str]:
    folder = tmp_path_factory.mktemp("bench")
    save_eager_model(folder, "tiny")
    out = folder / "speed" / "cpu.json"
    words = ["bench-inference", "--model", "tiny", "--models-dir", str(folder), "--json", str(out)]
    result = dgs([*words, "--threads", "1", "--repeat", "3", "--warm-up", "1"])
    return json.loads(out.read_text()), result.output


def test_the_file_holds_times_stages_and_machine(measured: tuple[dict, str]) -> None:
    values, _ = measured
    assert 0 < values["network_s"] < values["total_s"] <= values["total_p90_s"]
    stages = values["stages"]
    assert set(stages) == {
        *("prepare", "height_field", "geometry", "network", "decode"),
        *("level_pinch", "part", "contact", "check", "rank"),
    }
    assert sum(stages.values()) == pytest.approx(values["total_s"], rel=0.5)
    assert values["network_s"] == pytest.approx(stages["network"], rel=0.5)
    assert values["points_used"] == MAX_POINTS < values["points_in"]
    assert values["grasps"] > 0 and values["threads"] == 1 and values["repeat"] == 3
    assert values["machine"]["cores"] >= 1 and values["machine"]["processor"]
    assert len(values["model"]["sha256"]) == 64


def test_what_is_printed_is_what_is_written(measured: tuple[dict, str]) -> None:
    values, text = measured
    table = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line}
    assert table["total"][0] == f"{values['total_s'] * 1e3:.1f}"
    assert table["contact"][1] == f"{values['stages_p90']['contact'] * 1e3:.1f}"
    assert values["machine"]["processor"] in text and "1 threads" in text


def test_the_scene_is_fixed_and_gives_the_papers_number_of_points() -> None:
    cloud, camera = bench_scene()
    np.testing.assert_array_equal(cloud, bench_scene()[0])
    rows = prepare_rows(cloud, np.random.default_rng(0))
    assert len(rows) == MAX_POINTS
    assert camera[2] > 0.5

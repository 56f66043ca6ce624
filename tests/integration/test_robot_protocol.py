"""The robot protocol with the real suite, one short scene with an untrained network; a scene that cannot be made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dgs_description.errors import ErrorCode
from dgs_learning.evaluation import robot
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.provenance import describe_planner
from dgs_learning.evaluation.robot import SuiteFailed, run_robot, scene_folder
from dgs_learning.evaluation.run import run_row
from dgs_sim_bridge.render.object_model import find_catalogue
from tests.dgs_grasp_planner.models import save_eager_model
from tests.support.refused import refused

pytestmark = pytest.mark.integration

ONE = Row("robot", scenes=1, objects_per_scene=(2, 2), seed=4, arm=True, speed_up=2.0)
OBJECTS = find_catalogue("novel")[:6]


@pytest.fixture(autouse=True)
def surroundings(ros_domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    monkeypatch.setattr(robot, "TIME_LIMIT", 8.0)


def test_a_scene_is_cleared_once_and_kept(tmp_path: Path) -> None:
    save_eager_model(tmp_path / "models", "tiny")
    row = replace(ONE, weights=str(tmp_path / "models" / "tiny"))
    catalogue, folder, described = OBJECTS, tmp_path / "run", describe_planner(row)
    summary = run_robot(catalogue, row, described, folder)
    assert (summary["scenes"], summary["objects"], summary["suite_failures"]) == (1, 2, 0)
    assert summary["setting"]["model"] == "tiny"
    assert summary["per_scene"][0]["seed"] == 4000
    kept = scene_folder(folder, 0) / "summary.json"
    before = kept.stat().st_mtime_ns
    again = run_robot(catalogue, row, described, folder)
    assert kept.stat().st_mtime_ns == before
    assert again["attempts"] == summary["attempts"]


def test_a_scene_that_cannot_be_made_is_no_result(tmp_path: Path) -> None:
    """More objects than the simulator takes: the demo refuses, and its folder is kept apart."""
    save_eager_model(tmp_path / "models", "tiny")
    many = replace(ONE, objects_per_scene=(31, 31), weights=str(tmp_path / "models" / "tiny"))
    with pytest.raises(SuiteFailed, match=r"failed in scenes \[0\]"):
        run_robot(OBJECTS, many, describe_planner(many), tmp_path / "run")
    log = tmp_path / "run" / "scenes" / "scene_0000.broken1" / "demo.log"
    assert "0 to 30 are possible" in log.read_text()
    assert not scene_folder(tmp_path / "run", 0).exists()


def test_missing_weights_are_refused_before_anything_is_started(tmp_path: Path) -> None:
    with refused(ErrorCode.WEIGHTS_MISSING, "none"):
        run_row(replace(ONE, weights=str(tmp_path / "none")), tmp_path / "run")
    assert not (tmp_path / "run").exists()

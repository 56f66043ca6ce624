"""The robot protocol with the real suite, one short scene with an untrained network; a suite that cannot start."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgs_learning import paths
from dgs_learning.evaluation.baselines import PlannerChoice
from dgs_learning.evaluation.protocol import Setting
from dgs_learning.evaluation.robot import SuiteFailed, run_robot, scene_folder
from dgs_sim_bridge.object_model import load_catalogue
from tests.dgs_grasp_planner.models import save_eager_model

pytestmark = [pytest.mark.integration, pytest.mark.timeout(400)]

ONE = Setting(scenes=1, objects_per_scene=(2, 2), area=(0.4, 0.8), seed=4)


@pytest.fixture(autouse=True)
def domain(ros_domain_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))


def test_a_scene_is_cleared_once_and_kept(tmp_path: Path) -> None:
    save_eager_model(tmp_path / "models", "tiny")
    choice = PlannerChoice(model="tiny", models_dir=tmp_path / "models")
    catalogue, folder = load_catalogue(paths.novel_file())[:6], tmp_path / "run"
    summary = run_robot(catalogue, "six", choice, ONE, folder, speed_up=2.0, time_limit=8.0)
    assert (summary["scenes"], summary["objects"], summary["suite_failures"]) == (1, 2, 0)
    assert summary["setting"]["model"] == "tiny"
    assert summary["per_scene"][0]["seed"] == 4000
    kept = scene_folder(folder, 0) / "summary.json"
    before = kept.stat().st_mtime_ns
    again = run_robot(catalogue, "six", choice, ONE, folder, speed_up=2.0, time_limit=8.0)
    assert kept.stat().st_mtime_ns == before
    assert again["attempts"] == summary["attempts"]


def test_a_suite_that_does_not_start_is_no_result(tmp_path: Path) -> None:
    choice = PlannerChoice(model="missing", models_dir=tmp_path)
    with pytest.raises(SuiteFailed, match=r"failed in scenes \[0\]"):
        run_robot(
            load_catalogue(paths.novel_file())[:6], "six", choice, ONE, tmp_path / "run", time_limit=8.0
        )
    log = tmp_path / "run" / "scenes" / "scene_0000.broken1" / "demo.log"
    assert "grasp_planner_node ended" in log.read_text()
    assert not scene_folder(tmp_path / "run", 0).exists()

"""A rehearsal: the parts of the suite clear a table without ROS, and again in the same way."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dgs_description.errors import ErrorCode
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.report.page import write_report
from dgs_learning.evaluation.robot import load_robot_scene, scene_folder
from dgs_learning.evaluation.run import run_row
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts, save_catalogue
from tests.support.refused import refused


def box(name: str, x: float, y: float, z: float, mass: float) -> ObjectModel:
    corners = np.array([[a * x, b * y, c * z] for a in (-0.5, 0.5) for b in (-0.5, 0.5) for c in (-0.5, 0.5)])
    return from_parts(name, "cuboid", "box", [corners], mass)


def test_a_table_is_cleared_and_a_wide_thing_pushed_over_the_edge(tmp_path: Path) -> None:
    file, folder = tmp_path / "boxes.npz", tmp_path / "run"
    save_catalogue(file, [box("block", 0.05, 0.06, 0.09, 0.15), box("book", 0.16, 0.20, 0.03, 0.20)])
    row = Row("boxes", objects=str(file), objects_per_scene=(2, 2), scenes=1, seed=3, arm=True, rehearse=True)
    summary = run_row(row, folder)
    assert summary["attempts"] >= 2 and summary["cleared"] == 2, "the arm did what the camera showed"
    scene = load_robot_scene(folder, 0)
    assert scene["error_code"] == ErrorCode.SUCCESS and "push" in scene["message"]
    assert set(scene["places"].values()) == {"bin"}
    sources = [record["source"] for record in scene["records"] if record["success"]]
    assert "edge_pinch" in sources and scene["simulated_seconds"] > 10.0
    assert run_row(row, folder)["sr"] == summary["sr"], "what is done is kept"
    report = write_report([folder], folder / "report.html").read_text()
    assert "rehearsed without ROS" in report


def test_a_planner_that_cannot_be_loaded_is_no_result(tmp_path: Path) -> None:
    row = Row(
        "none", weights=str(tmp_path / "none"), scenes=1, objects_per_scene=(1, 1), arm=True, rehearse=True
    )
    with refused(ErrorCode.WEIGHTS_MISSING, "none.pt"):
        run_row(row, tmp_path / "run")
    assert not scene_folder(tmp_path / "run", 0).exists()

"""A rehearsal: the parts of the suite clear a table without ROS, and again in the same way."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from dgs_arm_executor.execution import Report
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_bringup.clear_table import ClearTableParameters
from dgs_bringup.truth import TruthTracker
from dgs_description.errors import ErrorCode
from dgs_learning.evaluation import rehearsal
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.report.page import write_report
from dgs_learning.evaluation.robot import load_robot_scene, scene_folder
from dgs_learning.evaluation.run import run_row
from dgs_sim_bridge.render.object_model import ObjectModel, find_catalogue, from_parts, save_catalogue
from dgs_sim_bridge.world.world import World
from tests.support.grasps import top_grasps
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
        rehearsal.run_rehearsal(find_catalogue("novel"), row, {}, tmp_path / "run", 1)
    assert not scene_folder(tmp_path / "run", 0).exists()


def test_the_world_goes_on_while_the_hand_comes_to_rest() -> None:
    """It is asked for where a finger is jammed over the bin."""
    world = World(())
    robot = rehearsal.RehearsalRobot(world, ArmExecutorParameters(), 0, "raw")
    begun = world.time
    rest = robot.watch.hand_at_rest()
    assert world.time >= begun + 0.1
    np.testing.assert_allclose(rest.hand_joints, 0.0, atol=0.05)
    world.close()


def test_a_grasp_has_neither_what_a_push_got_nor_the_refusals_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last attempt that is allowed fails, and the arm goes home after it."""
    truth, homings = TruthTracker(), []
    grasps = top_grasps(np.tile([0.3, 0.0, -0.1], (33, 1)))
    push = replace(grasps[:1], active_fingers=np.zeros((1, 5), bool), motion=np.array([[0.1, 0.0, 0.0]]))
    looks = [push, grasps]
    reports = [
        Report(executed_index=0),
        Report(ErrorCode.NO_FEASIBLE_GRASP, "none of 32"),
        Report(ErrorCode.NOTHING_HELD, executed_index=0),
    ]

    class Scripted:
        def __init__(self, *_: object) -> None: ...

        def go_home(self) -> Report:
            homings.append(len(reports))
            return Report()

        def pick(self, *_: object) -> Report:
            truth.update(1.0, ["ball"], ["bin"])  # the push has it roll there
            return reports.pop(0)

    def world(_: object) -> SimpleNamespace:
        picture = SimpleNamespace(
            shot=lambda: SimpleNamespace(truth=None), colour=lambda _: np.zeros((2, 2, 3), np.uint8)
        )
        return SimpleNamespace(time=0.0, close=lambda: None, snapshot=lambda: picture)

    def predict(*_: object) -> SimpleNamespace:
        return SimpleNamespace(grasps=looks.pop(0))

    robot = SimpleNamespace(truth=truth, table_force={}, see=lambda: np.zeros((1, 3)))
    fakes = {"World": world, "RehearsalRobot": lambda *_: robot, "Execution": Scripted}
    fakes |= {
        "predict_in_cell": predict,
        "ClearTableParameters": lambda: ClearTableParameters(max_attempts=2),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(rehearsal, name, fake)
    summary = rehearsal.Rehearsal([], lambda: None, 0, "imagers").run(tmp_path)  # type: ignore[arg-type,return-value]
    assert summary["error_code"] == ErrorCode.TASK_ATTEMPTS_USED_UP and not reports
    assert [record["success"] for record in summary["records"]] == [False]
    assert summary["refusals"] == [] and homings == [3, 2, 0]

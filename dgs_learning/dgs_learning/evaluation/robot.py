"""The robot protocol (section VI, Table V): scenes cleared by the whole ROS suite, one after the other, resumable.

Every scene is one run of `scripts/demo.sh`: simulator, camera, planner, arm, hand and task as processes of their own.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_grasp_planner.planner import SHIPPED
from dgs_learning import paths
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.provenance import write_summary
from dgs_learning.evaluation.records import claim, follow
from dgs_learning.evaluation.robot_metrics import summarise_robot
from dgs_sim_bridge.render.object_model import ObjectModel, save_catalogue

DEMO = Path("ros2_ws/src/dgs_bringup/scripts/demo.sh")
TIME_LIMIT = 1200.0
"""A scene that is not cleared after so long ends as it is [s of wall time]."""
SUITE_CODES = (
    ErrorCode.TASK_PLANNER_UNAVAILABLE,
    ErrorCode.TASK_ARM_UNAVAILABLE,
    ErrorCode.TASK_PLANNER_FAILED,
    ErrorCode.TASK_NO_CLOUD,
)
"""Ends of `/clear_table` that are the suite's failure."""
ANSWER_TIMEOUT = 120.0
"""Camera and planner may take so long to answer [s of wall time]; a busy machine needs it."""
READY = 180.0
"""The suite may take so long until all nodes are ready [s]; a busy machine needs it."""
STARTING = READY + 300.0
"""What the suite may take to start, reset and end, beyond the time limit [s]."""
ENDING = 60.0
"""The start script may take so long to end its nodes [s]."""
SEEDS_PER_RUN = 1000
"""Scene k of seed s has the simulator's seed 1000 s + k, so `make demo` can show it again."""


class SuiteFailed(Exception):
    """The suite did not carry a scene through: a node died, or not all were ready in time."""


def check_robot_row(row: Row) -> None:
    """Refuse what the robot cell cannot do.

    Raises:
        ValueError: another planner than the node's, another workspace or other views, or too many scenes.
    """
    if (row.proposers, row.without, row.ablate) != (SHIPPED, (), "none"):
        raise ValueError("with --arm the planner is the node's: no other proposers or stages, no ablation")
    if row.engine != "pybullet":
        raise ValueError("with --arm the engine is the simulator node's, PyBullet")
    glass = Condition(transparent=row.condition.transparent, depth_from=row.condition.depth_from)
    if row.workspace != CELL.workspace_size or row.condition != glass:
        x, y = CELL.workspace_size
        raise ValueError(f"with --arm hardware, camera and workspace are the cell's, {x:g} x {y:g} m")
    if row.scenes > SEEDS_PER_RUN:
        raise ValueError(f"{row.scenes} scenes are too many: at most {SEEDS_PER_RUN}")


def scene_request(row: Row, number: int) -> tuple[int, int]:
    """Simulator's seed and number of objects of a scene; they depend on the row's seed and the number alone."""
    low, high = row.objects_per_scene
    count = np.random.default_rng([row.seed, 101, number]).integers(low, high + 1)
    return SEEDS_PER_RUN * row.seed + number, int(count)


def scene_folder(folder: Path, number: int) -> Path:
    """Where the demo's files of a finished scene lie."""
    return folder / "scenes" / f"scene_{number:04d}"


def load_robot_scene(folder: Path, number: int) -> dict[str, Any]:
    """`summary.json` of a finished scene."""
    return json.loads((scene_folder(folder, number) / "summary.json").read_text())


def todo_and_done(folder: Path, scenes: int) -> tuple[list[int], list[dict[str, Any]]]:
    """Numbers of the scenes that are not finished, and the summaries of those that are."""
    todo = [n for n in range(scenes) if not scene_folder(folder, n).is_dir()]
    return todo, [load_robot_scene(folder, n) for n in range(scenes) if n not in todo]


def carried_through(folder: Path) -> bool:
    """Whether the demo's folder holds a result: the run ended by itself, at its time limit or by a fault of the arm.

    A run that ended because a part of the suite did not answer says something about the machine, not about the robot.
    """
    file = folder / "summary.json"
    return file.is_file() and json.loads(file.read_text())["error_code"] not in SUITE_CODES


def run_robot(
    catalogue: Sequence[ObjectModel],
    row: Row,
    described: dict[str, Any],
    folder: Path,
) -> dict[str, Any]:
    """Run or finish the robot protocol and write `summary.json`.

    Args:
        row: the robot can do it (`check_robot_row`).
        described: planner, objects and scenes, with their hashes.
        folder: results go here, one folder per finished scene.

    Raises:
        ValueError: the folder belongs to another setting.
        SuiteFailed: the suite itself failed in a scene; a new start tries those scenes again.
    """
    described = {"protocol": "robot", **described, "speed_up": row.speed_up, "time_limit": TIME_LIMIT}
    described["overlap"] = row.overlap
    claim(folder, described)
    save_catalogue(folder / "objects.npz", catalogue)
    _write_parameters(folder / "parameters.yaml", row)
    todo, done = todo_and_done(folder, row.scenes)
    follow((_clear(folder, n, row) for n in todo), len(todo), done, summarise_robot)
    if broken := [n for n in todo if not scene_folder(folder, n).is_dir()]:
        raise SuiteFailed(
            f"the suite failed in scenes {broken}: see demo.log in {folder}/scenes/*.broken*; start again to repeat"
        )
    return finish_robot(folder, described, row.scenes)


def finish_robot(folder: Path, described: dict[str, Any], scenes: int) -> dict[str, Any]:
    """Summary of the first `scenes` scenes, read back from their folders."""
    loaded = [load_robot_scene(folder, n) for n in range(scenes)]
    columns = ("seed", "objects", "attempts", "successes", "cleared", "error_code", "message")
    numbers = {
        **summarise_robot(loaded),
        "suite_failures": len(list((folder / "scenes").glob("*.broken*"))),
        "per_scene": [{key: scene[key] for key in columns} for scene in loaded],
    }
    return write_summary(folder, described, numbers, (scene["revision"] for scene in loaded))


def _write_parameters(path: Path, row: Row) -> None:
    values = {
        "sim_bridge_node": {
            "real_time_factor": float(row.speed_up),
            "transparent": float(row.condition.transparent),
        },
        "camera_node": {"depth_from": row.condition.depth_from},
        "clear_table": {
            "cloud_timeout": ANSWER_TIMEOUT,
            "predict_timeout": ANSWER_TIMEOUT,
            "overlap": row.overlap,
        },
        "grasp_planner_node": {"models_dir": str(row.models_dir.resolve()), "model": row.model},
    }
    path.write_text(yaml.safe_dump({node: {"ros__parameters": given} for node, given in values.items()}))


def _clear(folder: Path, number: int, row: Row) -> dict[str, Any] | None:
    """Clear one scene; its summary, None if the suite did not carry it through."""
    target = scene_folder(folder, number)
    unfinished = target.with_name(target.name + ".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    seed, count = scene_request(row, number)
    options = {
        "--out": unfinished, "--params": folder / "parameters.yaml", "--seed": seed, "--objects": count,
        "--catalogue": (folder / "objects.npz").resolve(), "--timeout": READY, "--time-limit": TIME_LIMIT,
    }  # fmt: skip
    words = [str(word) for option in options.items() for word in option]
    command = ["bash", str(paths.repository() / DEMO), *words, "--no-bag"]
    with (unfinished / "demo.log").open("wb") as log, _process(command, log) as process:
        try:
            status = process.wait(TIME_LIMIT + STARTING)
        except subprocess.TimeoutExpired:
            status = None
    if status in (0, 1) and carried_through(unfinished):
        unfinished.rename(target)
        return load_robot_scene(folder, number)
    earlier = len(list(target.parent.glob(target.name + ".broken*")))
    unfinished.rename(target.with_name(f"{target.name}.broken{earlier + 1}"))
    return None


@contextmanager
def _process(command: Sequence[str], log: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A child in a session of its own that ends with the block, and with this process when that is asked to end."""

    def leave(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, leave)
    streams = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": subprocess.STDOUT}
    process = subprocess.Popen(command, **streams, start_new_session=True)
    try:
        yield process
    finally:
        signal.signal(signal.SIGTERM, before)
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(ENDING)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

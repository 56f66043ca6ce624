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
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from dgs_description.errors import ErrorCode
from dgs_description.frames import CELL
from dgs_grasp_planner.network.weights import read_info
from dgs_grasp_planner.planner import SHIPPED
from dgs_learning import paths
from dgs_learning.evaluation.proposers import PlannerChoice
from dgs_learning.evaluation.protocol import Setting
from dgs_learning.evaluation.provenance import describe_catalogue, describe_planner, today
from dgs_learning.evaluation.records import claim
from dgs_learning.evaluation.robot_metrics import summarise_robot
from dgs_sim_bridge.render.object_model import ObjectModel, save_catalogue

DEMO = Path("ros2_ws/src/dgs_bringup/scripts/demo.sh")
TIME_LIMIT = 1200.0
"""A scene that is not cleared after so long ends as it is [s of wall time]."""
SUITE_CODES = frozenset(
    {
        ErrorCode.TASK_PLANNER_UNAVAILABLE,
        ErrorCode.TASK_ARM_UNAVAILABLE,
        ErrorCode.TASK_PLANNER_FAILED,
        ErrorCode.TASK_NO_CLOUD,
    }
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


def check_robot_setting(choice: PlannerChoice, setting: Setting) -> None:
    """Refuse what the robot cell cannot do.

    Raises:
        ValueError: another planner than the node's, an ablation, another workspace, or too many scenes.
    """
    if choice.proposers != SHIPPED or choice.without or choice.ablate != "none":
        raise ValueError("with --arm the planner is the node's: what ships, without ablation")
    if tuple(setting.area) != CELL.workspace_size:
        x, y = CELL.workspace_size
        raise ValueError(
            f"the robot's workspace is {x:g} x {y:g} m, not {setting.area[0]:g} x {setting.area[1]:g} m"
        )
    if setting.scenes > SEEDS_PER_RUN:
        raise ValueError(f"{setting.scenes} scenes are too many: at most {SEEDS_PER_RUN}")


def scene_request(setting: Setting, number: int) -> tuple[int, int]:
    """Simulator's seed and number of objects of a scene; they depend on the run's seed and the number alone."""
    low, high = setting.objects_per_scene
    count = np.random.default_rng([setting.seed, 101, number]).integers(low, high + 1)
    return SEEDS_PER_RUN * setting.seed + number, int(count)


def scene_folder(folder: Path, number: int) -> Path:
    """Where the demo's files of a finished scene lie."""
    return folder / "scenes" / f"scene_{number:04d}"


def load_robot_scene(folder: Path, number: int) -> dict[str, Any]:
    """`summary.json` of a finished scene."""
    summary: dict[str, Any] = json.loads((scene_folder(folder, number) / "summary.json").read_text())
    return summary


def carried_through(folder: Path) -> bool:
    """Whether the demo's folder holds a result: the run ended by itself, at its time limit or by a fault of the arm.

    A run that ended because a part of the suite did not answer says something about the machine, not about the robot.
    """
    file = folder / "summary.json"
    return file.is_file() and json.loads(file.read_text())["error_code"] not in SUITE_CODES


def run_robot(
    catalogue: Sequence[ObjectModel],
    catalogue_name: str,
    choice: PlannerChoice,
    setting: Setting,
    folder: Path,
    speed_up: float = 1.0,
    time_limit: float = TIME_LIMIT,
) -> dict[str, Any]:
    """Run or finish the robot protocol and write `summary.json`.

    Args:
        catalogue: objects to draw scenes from.
        catalogue_name: what to call them in the report.
        choice: the network's weights.
        setting: number of scenes, objects per scene, seed.
        folder: results go here, one folder per finished scene.
        speed_up: simulated seconds per second, where the machine can; at least 1.
        time_limit: a scene that is not cleared after so long ends as it is [s of wall time].

    Returns:
        the summary.

    Raises:
        ValueError: the robot cannot do this setting, or the folder belongs to another one.
        DgsError: WEIGHTS_MISSING or WEIGHTS_ALTERED.
        SuiteFailed: the suite itself failed in a scene; a new start tries those scenes again.
    """
    check_robot_setting(choice, setting)
    read_info(choice.models_dir or paths.models_dir(), choice.model)
    described = json.loads(
        json.dumps(
            {
                "protocol": "robot",
                **describe_planner(choice),
                "objects": describe_catalogue(catalogue_name, catalogue),
                **asdict(setting),
                "speed_up": speed_up,
                "time_limit": time_limit,
            }
        )
    )
    claim(folder, described)
    objects = folder / "objects.npz"
    save_catalogue(objects, catalogue)
    parameters = _write_parameters(folder / "parameters.yaml", choice, speed_up)
    todo = [n for n in range(setting.scenes) if not scene_folder(folder, n).is_dir()]
    done = [load_robot_scene(folder, n) for n in range(setting.scenes) if n not in todo]
    broken = []
    with tqdm(todo, unit="scene") as progress:
        for number in progress:
            if not _clear(folder, number, setting, objects, parameters, time_limit):
                broken.append(number)
                continue
            done.append(load_robot_scene(folder, number))
            so_far = summarise_robot(done)
            progress.set_postfix(sr=f"{so_far['sr']:.2f}", cr=f"{so_far['cr_pooled']:.2f}")
    if broken:
        raise SuiteFailed(
            f"the suite failed in scenes {broken}: see demo.log in {folder}/scenes/*.broken*; start again to repeat"
        )
    return write_robot_summary(folder, described, setting.scenes)


def write_robot_summary(folder: Path, described: dict[str, Any], scenes: int) -> dict[str, Any]:
    """Summary of the first `scenes` scenes, read back from their folders."""
    loaded = [load_robot_scene(folder, n) for n in range(scenes)]
    columns = ("seed", "objects", "attempts", "successes", "cleared", "error_code", "message")
    summary = {
        **summarise_robot(loaded),
        "suite_failures": len(list((folder / "scenes").glob("*.broken*"))),
        "per_scene": [{key: scene[key] for key in columns} for scene in loaded],
        "setting": {
            **described,
            "revision": ", ".join(dict.fromkeys(scene["revision"] for scene in loaded)),
            "date": today(),
        },
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def robot_table(summary: dict[str, Any]) -> str:
    """A few readable lines."""
    low, high = np.array(summary["sr_interval"]) * 100
    times, failures = summary["time_s"], summary["failures"]
    return "\n".join(
        [
            f"scenes {summary['scenes']}  attempts {summary['attempts']}  SR {summary['sr'] * 100:.1f} % "
            f"[{low:.1f}, {high:.1f}]  without faults of arm and hand {summary['sr_grasp'] * 100:.1f} %  "
            f"CR {summary['cr_pooled'] * 100:.1f} % ({summary['cleared']} of {summary['objects']} objects)",
            "  failures: " + ", ".join(f"{kind} {count}" for kind, count in failures.items()),
            "  after the lift: "
            + ", ".join(f"{kind} {count}" for kind, count in summary["after_lift"].items()),
            "  grasps that the arm refused: "
            + (", ".join(f"{count} {name}" for name, count in summary["refused_grasps"].items()) or "none"),
            f"  {times['wall']:.1f} s of wall time per attempt, {times['simulated']:.1f} s simulated",
        ]
    )


def _write_parameters(path: Path, choice: PlannerChoice, speed_up: float) -> Path:
    models = (choice.models_dir or paths.models_dir()).resolve()
    values = {
        "sim_bridge_node": {"real_time_factor": float(speed_up)},
        "clear_table": {"cloud_timeout": ANSWER_TIMEOUT, "predict_timeout": ANSWER_TIMEOUT},
        "grasp_planner_node": {"models_dir": str(models), "model": choice.model},
    }
    # JSON is YAML, and its strings need no care.
    path.write_text(json.dumps({node: {"ros__parameters": given} for node, given in values.items()}) + "\n")
    return path


def _clear(
    folder: Path, number: int, setting: Setting, objects: Path, parameters: Path, time_limit: float
) -> bool:
    """Clear one scene; False if the suite did not carry it through."""
    target = scene_folder(folder, number)
    unfinished = target.with_name(target.name + ".unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    unfinished.mkdir(parents=True)
    seed, count = scene_request(setting, number)
    command = ["bash", str(paths.repository() / DEMO), "--out", str(unfinished), "--params", str(parameters)]
    command += ["--seed", str(seed), "--objects", str(count), "--catalogue", str(objects.resolve())]
    command += ["--timeout", str(READY), "--time-limit", str(time_limit), "--no-bag"]
    with (unfinished / "demo.log").open("wb") as log, _process(command, log) as process:
        try:
            status = process.wait(time_limit + STARTING)
        except subprocess.TimeoutExpired:
            status = None
    if status in (0, 1) and carried_through(unfinished):
        unfinished.rename(target)
        return True
    earlier = len(list(target.parent.glob(target.name + ".broken*")))
    unfinished.rename(target.with_name(f"{target.name}.broken{earlier + 1}"))
    return False


@contextmanager
def _process(command: Sequence[str], log: Any) -> Iterator[subprocess.Popen[bytes]]:
    """A child in a session of its own that ends with the block, and with this process when that is asked to end."""

    def leave(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, leave)
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
    )
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

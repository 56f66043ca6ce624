"""Runs a row of an experiment: scenes in parallel, each kept at once, so that a stopped run goes on where it was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from dgs_description.paths import revision
from dgs_grasp_planner.network.weights import read_info
from dgs_learning.dataset import load_dataset
from dgs_learning.evaluation.experiment import WITH_NETWORK, Row
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.proposers import planner_of
from dgs_learning.evaluation.protocol import SceneResult, SceneRun, run_scene
from dgs_learning.evaluation.provenance import (
    describe_catalogue,
    describe_planner,
    write_summary,
)
from dgs_learning.evaluation.records import (
    claim,
    cloud_to_keep,
    failure_file,
    follow,
    load_scene,
    save_scene,
    scene_file,
    write_attempts,
)
from dgs_learning.evaluation.report.pictures import as_jpeg, draw_failure
from dgs_learning.evaluation.robot import check_robot_row, run_robot
from dgs_learning.objects.catalogue import TEST_CATALOGUES, load_part
from dgs_learning.parallel import Engine
from dgs_learning.training.views import View
from dgs_sim_bridge.render.object_model import ObjectModel, find_catalogue


def check_row(row: Row) -> list[ObjectModel]:
    """The objects that a row's scenes are drawn from.

    Raises:
        ValueError: the robot cannot do this setting.
        DgsError: the weights or the objects are missing or altered.
    """
    if row.arm:
        check_robot_row(row)
    if set(row.proposers) & set(WITH_NETWORK):
        read_info(row.models_dir, row.model)
    return _catalogue(row.objects, row.dataset_file)


@cache
def _catalogue(objects: str, dataset: Path) -> list[ObjectModel]:
    if objects == "dataset":
        return load_dataset(dataset).objects
    if objects in TEST_CATALOGUES:
        return find_catalogue(objects)
    return load_part(objects)


def run_row(row: Row, folder: Path, workers: int = 1) -> dict[str, Any]:
    """Run or finish a row and write `summary.json` and, of a free hand, `attempts.csv`.

    Args:
        folder: results go here, one file per finished scene.
        workers: processes, 0 = one per core; the results do not depend on their number. The robot clears one scene
            after the other.

    Returns:
        the summary.

    Raises:
        ValueError, DgsError: as of `check_row`; the folder belongs to another setting.
        SuiteFailed: the suite failed in a scene of the robot's.
    """
    catalogue = check_row(row)
    described = {
        **describe_planner(row),
        "objects": describe_catalogue(Path(row.objects).name, catalogue),
        **asdict(row.setting),
        **({} if row.engine == "pybullet" else {"engine": row.engine}),
        **row.condition.described(),
    }
    if row.rehearse:
        from dgs_learning.evaluation.rehearsal import run_rehearsal  # needs ROS's message types

        return run_rehearsal(catalogue, row, described, folder, workers)
    if row.arm:
        return run_robot(catalogue, row, described, folder)
    claim(folder, described)
    todo = [n for n in range(row.scenes) if not scene_file(folder, n).exists()]
    results = [load_scene(folder, n)[0] for n in range(row.scenes) if n not in todo]
    made_by = revision()
    running = Engine(workers).run(_one, ((catalogue, row, n, folder, made_by) for n in todo))
    follow(running, len(todo), results, summarise)
    return finish(folder, described, row.scenes)


def _one(catalogue: Sequence[ObjectModel], row: Row, number: int, folder: Path, made_by: str) -> SceneResult:
    clouds: list[np.ndarray] = []
    for stale in failure_file(folder, number, 0).parent.glob(f"scene_{number:04d}_*"):
        stale.unlink()  # of a start that did not finish the scene

    def keep(run: SceneRun, view: View) -> None:
        if run.executed is not None and run.executed.failed is not None:
            file = failure_file(folder, number, len(clouds))
            file.parent.mkdir(exist_ok=True)
            picture = draw_failure(run.world.models, run.executed, row.setting.edge)
            file.write_bytes(as_jpeg(picture))
        clouds.append(cloud_to_keep(view.points))

    factory = partial(planner_of, row)
    result = run_scene(catalogue, factory, row.setting, number, row.condition, row.engine, keep)
    save_scene(folder, result, made_by, clouds)
    return result


def finish(folder: Path, described: dict[str, Any], scenes: int) -> dict[str, Any]:
    """Summary and attempts of the first `scenes` scenes, read back from their files."""
    loaded = [load_scene(folder, n) for n in range(scenes)]
    results = [result for result, _ in loaded]
    write_attempts(folder / "attempts.csv", results)
    return write_summary(folder, described, summarise(results), (by for _, by in loaded))

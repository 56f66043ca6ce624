"""Runs an experiment: scenes in parallel, each result kept at once, so that a stopped run goes on where it was."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from dgs_learning import paths
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.protocol import AttemptRecord, Planner, SceneResult, Setting, run_scene
from dgs_sim_bridge.object_model import ObjectModel


@cache
def make_planner(name: str, models_dir: str, model: str) -> Planner:
    """A planner by name: `dgs_net` (weights `model` in `models_dir`)."""
    planners: dict[str, Callable[[], Planner]] = {"dgs_net": lambda: _dgs_net(models_dir, model)}
    if name not in planners:
        raise ValueError(f"no planner named {name!r}; there are {', '.join(planners)}")
    return planners[name]()


def _dgs_net(models_dir: str, model: str) -> Planner:
    import torch

    from dgs_grasp_planner.planner import DgsNetPlanner

    torch.set_num_threads(1)
    return DgsNetPlanner.from_weights(models_dir, model)


def _scene_file(folder: Path, number: int) -> Path:
    return folder / "scenes" / f"scene_{number:04d}.json"


def _one(
    catalogue: Sequence[ObjectModel], planner: tuple[str, str, str], setting: Setting, number: int, folder: Path
) -> SceneResult:
    result = run_scene(catalogue, make_planner(*planner), setting, number)
    path = _scene_file(folder, number)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(asdict(result)))
    os.replace(partial, path)
    return result


def _load(path: Path) -> SceneResult:
    values = json.loads(path.read_text())
    attempts = tuple(
        AttemptRecord(**{k: tuple(v) if isinstance(v, list) else v for k, v in a.items()}) for a in values.pop("attempts")
    )
    return SceneResult(**values, attempts=attempts)


def run_experiment(
    catalogue: Sequence[ObjectModel],
    planner: str,
    setting: Setting,
    folder: Path,
    workers: int,
    model: str = "dgs_net",
    models_dir: Path | None = None,
) -> dict[str, Any]:
    """Run or finish an experiment and write `summary.json` and `attempts.csv`.

    Args:
        catalogue: objects to draw scenes from.
        planner: name, see `make_planner`.
        setting: the experiment; a folder that holds another one is refused.
        folder: results go here, one file per finished scene.
        workers: processes.

    Raises:
        ValueError: the folder belongs to another setting.
    """
    key = (planner, str(models_dir or paths.models_dir()), model)
    (folder / "scenes").mkdir(parents=True, exist_ok=True)
    described = json.loads(json.dumps({"planner": planner, "model": model, **asdict(setting)}))
    mark = folder / "setting.json"
    if mark.exists() and json.loads(mark.read_text()) != described:
        raise ValueError(f"{folder} holds results of another setting: {mark.read_text()}")
    mark.write_text(json.dumps(described))
    numbers = range(setting.scenes)
    todo = [n for n in numbers if not _scene_file(folder, n).exists()]
    results = [_load(_scene_file(folder, n)) for n in numbers if n not in todo]
    jobs = (delayed(_one)(catalogue, key, setting, n, folder) for n in todo)
    with tqdm(Parallel(n_jobs=workers, return_as="generator_unordered")(jobs), total=len(todo), unit="scene") as progress:
        for result in progress:
            results.append(result)
            so_far = summarise(results)
            progress.set_postfix(sr=f"{so_far['sr']:.2f}", cr=f"{so_far['cr_pooled']:.2f}")
    results.sort(key=lambda r: r.scene)
    summary = {**summarise(results), "setting": described}
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    _write_attempts(folder / "attempts.csv", results)
    return summary


def _write_attempts(path: Path, results: Sequence[SceneResult]) -> None:
    columns = ("scene", "attempt", "object_name", "shape_class", "outcome", "score", "seconds")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for result in results:
            for attempt in result.attempts:
                writer.writerow([getattr(attempt, c) for c in columns])


def table(summary: dict[str, Any]) -> str:
    """A few readable lines."""
    low, high = np.array(summary["sr_interval"]) * 100
    lines = [
        f"attempts {summary['attempts']}  SR {summary['sr'] * 100:.1f} % [{low:.1f}, {high:.1f}]  "
        f"CR {summary['cr_pooled'] * 100:.1f} %  planner {summary['time_s'] * 1e3:.0f} ms"
    ]
    for name, row in summary["per_class"].items():
        lines.append(f"  {name:9s} {row['attempts']:4d} attempts  SR {row['sr'] * 100:5.1f} %")
    lines.append("  failures: " + ", ".join(f"{k} {v}" for k, v in summary["failures"].items()))
    return "\n".join(lines)

"""Runs an experiment: scenes in parallel, each result kept at once, so that a stopped run goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.proposers import PlannerChoice, planner_factory
from dgs_learning.evaluation.protocol import SceneResult, Setting, run_scene
from dgs_learning.evaluation.provenance import describe_catalogue, describe_planner, revision, today
from dgs_learning.evaluation.records import (
    claim,
    cloud_to_keep,
    load_scene,
    save_scene,
    scene_file,
    write_attempts,
)
from dgs_sim_bridge.render.object_model import ObjectModel


def _one(
    catalogue: Sequence[ObjectModel],
    choice: PlannerChoice,
    setting: Setting,
    number: int,
    folder: Path,
    made_by: str,
) -> SceneResult:
    clouds: list[np.ndarray] = []
    result = run_scene(
        catalogue,
        planner_factory(choice),
        setting,
        number,
        keep=lambda _, view: clouds.append(cloud_to_keep(view.points)),
    )
    save_scene(folder, result, made_by, clouds)
    return result


def run_experiment(
    catalogue: Sequence[ObjectModel],
    catalogue_name: str,
    choice: PlannerChoice,
    setting: Setting,
    folder: Path,
    workers: int = 1,
) -> dict[str, Any]:
    """Run or finish an experiment and write `summary.json` and `attempts.csv`.

    Args:
        catalogue: objects to draw scenes from.
        catalogue_name: what to call them in the report.
        choice: planner.
        setting: the experiment.
        folder: results go here, one file per finished scene.
        workers: processes; the results do not depend on their number.

    Returns:
        the summary.

    Raises:
        ValueError: the folder belongs to another setting.
    """
    described = json.loads(
        json.dumps(
            {
                **describe_planner(choice),
                "objects": describe_catalogue(catalogue_name, catalogue),
                **asdict(setting),
            }
        )
    )
    claim(folder, described)
    todo = [n for n in range(setting.scenes) if not scene_file(folder, n).exists()]
    results = [load_scene(folder, n)[0] for n in range(setting.scenes) if n not in todo]
    made_by = revision()
    jobs = (delayed(_one)(catalogue, choice, setting, n, folder, made_by) for n in todo)
    running = Parallel(n_jobs=workers, return_as="generator_unordered")(jobs)
    with tqdm(running, total=len(todo), unit="scene") as progress:
        for result in progress:
            results.append(result)
            so_far = summarise(results)
            progress.set_postfix(sr=f"{so_far['sr']:.2f}", cr=f"{so_far['cr_pooled']:.2f}")
    return write_summary(folder, described, setting.scenes)


def write_summary(folder: Path, described: dict[str, Any], scenes: int) -> dict[str, Any]:
    """Summary and table of the first `scenes` scenes, read back from their files."""
    loaded = [load_scene(folder, n) for n in range(scenes)]
    results = [result for result, _ in loaded]
    made_by = list(dict.fromkeys(by for _, by in loaded))
    summary = {
        **summarise(results),
        "setting": {**described, "revision": ", ".join(made_by), "date": today()},
    }
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    write_attempts(folder / "attempts.csv", results)
    return summary


def table(summary: dict[str, Any]) -> str:
    """A few readable lines."""
    low, high = np.array(summary["sr_interval"]) * 100
    lines = [
        f"scenes {summary['scenes']}  attempts {summary['attempts']}  "
        f"SR {summary['sr'] * 100:.1f} % [{low:.1f}, {high:.1f}]  CR {summary['cr_pooled'] * 100:.1f} % "
        f"(mean over scenes {summary['cr_scene_mean'] * 100:.1f} %)"
    ]
    for name, row in summary["per_class"].items():
        rate = f"{row['sr'] * 100:5.1f} %" if row["attempts"] else "  –"
        lines.append(f"  {name:9s} {row['attempts']:4d} attempts  SR {rate}")
    lines.append("  failures: " + ", ".join(f"{k} {v}" for k, v in summary["failures"].items()))
    if summary["attempts"]:
        pd, pv, spread = summary["pd_mm"], summary["pv_mm3"], summary["diversity"]
        lines.append(f"  penetration: {pd['mean']:.2f} mm, {pv['mean']:.0f} mm^3 (mean over attempts)")
        if spread is not None:
            lines.append(f"  diversity {spread * 100:.1f} %")
        lines.append(f"  planner {summary['time_s']['median'] * 1e3:.0f} ms (median)")
    return "\n".join(lines)

"""What the generation costs: grasps per second, time per trial and stage and per training view."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from dgs_description.stage_clock import StageClock
from dgs_learning.dataset import GraspDataset
from dgs_learning.synthesis.generate import work_list
from dgs_learning.synthesis.sdf import signed_distance
from dgs_learning.synthesis.stage_one import DRAWS, resting_ups, synthesise_chunk
from dgs_learning.training.views import ViewSource
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES, ObjectModel


def measure_grasps(per_class: int, trials: int) -> dict[str, Any]:
    """Stage 1 on the first objects of every class, one chunk per resting pose, on this core.

    Args:
        per_class: objects of every class.
        trials: simulated candidates per chunk, at most.
    """
    clock = StageClock(time.process_time)
    rows, by_class, items = [], {}, work_list(0, 1)
    for shape_class in SHAPE_CLASSES:
        mine = [item for item in items if item[0].shape_class == shape_class][:per_class]
        own = [_measure_object(model, key, trials, clock) for model, key in mine]
        summed = _total(own)
        by_class[shape_class] = {key: summed[key] for key in ("grasps", "grasps_per_core_second")}
        rows += own
    total = _total(rows)
    each = 1e3 / max(1, total["trials"])
    return {
        **total,
        "share_of_trials_kept": round(total["grasps"] / max(1, total["trials"]), 3),
        "stage_ms_per_trial": {stage: round(each * seconds, 2) for stage, seconds in clock.times.items()},
        "by_class": by_class,
        "objects": rows,
    }


def _total(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    total = {key: sum(row[key] for row in rows) for key in ("drawn", "trials", "grasps", "cpu_seconds")}
    rate = round(total["grasps"] / total["cpu_seconds"], 3)
    return {**total, "cpu_seconds": round(total["cpu_seconds"], 2), "grasps_per_core_second": rate}


def _measure_object(model: ObjectModel, key: list[int], trials: int, clock: StageClock) -> dict[str, Any]:
    started = time.process_time()
    with clock("distance grid"):
        sdf = signed_distance(model)
    with clock("resting poses"):
        ups = resting_ups(model, key[0])
    draws = DRAWS.get(model.shape_class, DRAWS["other"])
    chunks = [
        synthesise_chunk(model, sdf, up[None], [*key, k], draws, trials, clock=clock)
        for k, up in enumerate(ups)
    ]
    return {
        "name": model.name,
        "shape_class": model.shape_class,
        "drawn": sum(c.drawn for c in chunks),
        "trials": sum(c.trials for c in chunks),
        "grasps": sum(len(c.grasps) for c in chunks),
        "cpu_seconds": round(time.process_time() - started, 3),
    }


def measure_views(data: GraspDataset, count: int) -> dict[str, Any]:
    """Processor time of fresh training views, with the table (20 000 points) and with it left out far from objects."""
    result = {}
    for name, keep_table in (("with_table", True), ("near_objects", False)):
        source = ViewSource(data, seed=1, keep_table=keep_table)
        source.view(0, 10_000)  # warm-up
        times, points = [], []
        for k in range(count):
            started = time.process_time()
            view = source.view(k % len(data.scenes), k)
            times.append(1e3 * (time.process_time() - started))
            points.append(len(view.points))
        result[name] = {
            "views": count,
            "points": float(np.mean(points)),
            "median_ms": round(float(np.median(times)), 1),
            "p90_ms": round(float(np.percentile(times, 90)), 1),
        }
    return result

"""The numbers of section VI from finished attempts: SR and CR with Wilson intervals, PD, PV, D, time, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from dgs_learning.evaluation.diversity import diversity
from dgs_learning.evaluation.protocol import NO_GRASP, AttemptRecord, SceneResult
from dgs_learning.evaluation.scene_world import Outcome
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

FAILURES = (*(o.value for o in Outcome if o is not Outcome.SUCCESS), NO_GRASP)
DEEP_MM = 2.0
"""A deeper penetration than this is counted apart [mm]."""


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson score interval of a proportion (Wilson, 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    p = successes / trials
    centre = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * np.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))


def spread(values: Sequence[float], deep: float | None = None) -> dict[str, float]:
    """Mean, variance, median and 95th percentile; with `deep` also the share of values above it."""
    if not len(values):
        return {}
    data = np.asarray(values, dtype=np.float64)
    row = {
        "mean": float(data.mean()),
        "variance": float(data.var()),
        "median": float(np.median(data)),
        "p95": float(np.percentile(data, 95)),
    }
    return row if deep is None else {**row, f"share_over_{deep:g}": float((data > deep).mean())}


def rate(attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    """Success rate of executed attempts with its 95 % interval."""
    good = sum(a.success for a in attempts)
    return {
        "attempts": len(attempts),
        "successes": good,
        "sr": good / max(1, len(attempts)),
        "sr_interval": wilson(good, len(attempts)),
    }


def times(attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    """The planner's time per call [s]: spread of the whole, computing time, mean of every stage that it reports."""
    stages = dict.fromkeys(name for a in attempts for name in a.stage_times if name != "total")
    mean = {name: float(np.mean([a.stage_times.get(name, 0.0) for a in attempts])) for name in stages}
    computed = spread([a.cpu_seconds for a in attempts])
    return {**spread([a.seconds for a in attempts]), "cpu_mean": computed.get("mean", 0.0), "stages": mean}


def summarise(results: Sequence[SceneResult]) -> dict[str, Any]:
    """All numbers of finished scenes; rates in [0, 1], times in seconds.

    SR counts executed attempts (the paper's definition); "no grasp found" is no attempt, but its objects count
    against CR. CR is pooled over all objects, and as the mean over scenes.
    """
    attempts = [a for r in results for a in r.attempts]
    tried = [a for a in attempts if a.executed]
    objects, cleared = sum(r.objects for r in results), sum(r.cleared for r in results)
    counted = Counter(a.outcome for a in attempts)
    return {
        "scenes": len(results),
        "objects": objects,
        "cleared": cleared,
        **rate(tried),
        "cr_pooled": cleared / max(1, objects),
        "cr_interval": wilson(cleared, objects),
        "cr_scene_mean": float(np.mean([r.cleared / max(1, r.objects) for r in results])) if results else 0.0,
        "per_class": {name: rate([a for a in tried if a.shape_class == name]) for name in SHAPE_CLASSES},
        "level_pinches": rate([a for a in tried if a.source == "level_pinch"]),
        "failures": {name: counted[name] for name in FAILURES},
        "pd_mm": spread([a.pd_mm for a in tried], DEEP_MM),
        "pv_mm3": spread([a.pv_mm3 for a in tried]),
        "pd_closed_mm": spread([a.pd_closed_mm for a in tried], DEEP_MM),
        "pv_closed_mm3": spread([a.pv_closed_mm3 for a in tried]),
        "diversity": diversity(
            *([getattr(a, name) for a in tried] for name in ("position", "rotation", "pre_grasp", "grasp"))
        )
        if len(tried) > 1
        else None,
        "time_s": times(attempts),
    }

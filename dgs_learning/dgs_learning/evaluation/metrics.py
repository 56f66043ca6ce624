"""The numbers of section VI from finished attempts: SR and CR with Wilson intervals, PD, PV, D, time, failures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from dgs_learning.evaluation.protocol import NO_GRASP, AttemptRecord, SceneResult
from dgs_learning.evaluation.resting import KINDS
from dgs_learning.evaluation.scene_world import Outcome
from dgs_sim_bridge.render.object_model import MATERIALS, OPAQUE, SHAPE_CLASSES

FAILURES = (*(o.value for o in Outcome if o not in (Outcome.SUCCESS, Outcome.PUSHED)), NO_GRASP)
DEEP_MM = 2.0
"""A deeper penetration than this is counted apart [mm]."""


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion; (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def spread(values: Sequence[float], deep: float | None = None) -> dict[str, float]:
    """Mean, variance, median and 95th percentile; with `deep` also the share of values above it."""
    if not len(values):
        return {}
    data = np.asarray(values, dtype=np.float64)
    median, p95 = np.percentile(data, (50, 95)).tolist()
    row = {"mean": float(data.mean()), "variance": float(data.var()), "median": median, "p95": p95}
    return row if deep is None else {**row, f"share_over_{deep:g}": float((data > deep).mean())}


def diversity(position: ArrayLike, rotation: ArrayLike, pre_grasp: ArrayLike, grasp: ArrayLike) -> float:
    """Diversity D (paper, section VI): first eigenvalue of the covariance over the sum of all; lower = more diverse.

    The data points are T [m], R as axis times angle [rad], J_init and J_end [rad] side by side, as they are (the paper
    names no scaling).

    Args:
        position: (N, 3), rotation: (N, 3, 3), pre_grasp: (N, J), grasp: (N, J).

    Returns:
        in [0, 1]; NaN for fewer than two grasps or grasps that are all alike.
    """
    turn = np.asarray(rotation, dtype=np.float64).reshape(-1, 3, 3)
    if len(turn) < 2:
        return float("nan")
    columns = (position, Rotation.from_matrix(turn).as_rotvec(), pre_grasp, grasp)
    data = np.hstack([np.asarray(c, dtype=np.float64).reshape(len(turn), -1) for c in columns])
    eigenvalues = np.linalg.eigvalsh(np.cov(data.T))
    total = float(eigenvalues.sum())
    return float(eigenvalues[-1]) / total if total > 1e-12 else float("nan")


def success(good: int, tried: int) -> dict[str, Any]:
    """Success rate of executed attempts with its 95 % interval."""
    rate = good / max(1, tried)
    return {"attempts": tried, "successes": good, "sr": rate, "sr_interval": wilson(good, tried)}


def clearance(scenes: Sequence[tuple[int, int]]) -> dict[str, Any]:
    """Clearance of scenes, of each (cleared, objects): pooled over objects, and as the mean over scenes with any."""
    cleared, objects = sum(c for c, _ in scenes), sum(n for _, n in scenes)
    shares = [c / n for c, n in scenes if n]
    return {
        "scenes": len(scenes),
        "objects": objects,
        "cleared": cleared,
        "cr_pooled": cleared / max(1, objects),
        "cr_interval": wilson(cleared, objects),
        "cr_scene_mean": float(np.mean(shares)) if shares else 0.0,
    }


def times(attempts: Sequence[AttemptRecord]) -> dict[str, Any]:
    """The planner's time per call [s]: spread of the whole, computing time, mean of every stage that it reports."""
    stages = dict.fromkeys(name for a in attempts for name in a.stage_times if name != "total")
    mean = {name: float(np.mean([a.stage_times.get(name, 0.0) for a in attempts])) for name in stages}
    computed = spread([a.cpu_seconds for a in attempts])
    return {**spread([a.seconds for a in attempts]), "cpu_mean": computed.get("mean", 0.0), "stages": mean}


def _of_items(results: Sequence[SceneResult], field: str, value: str) -> dict[str, Any]:
    """Success and clearance of the items whose field has a value."""
    items = [item for r in results for item in r.items if getattr(item, field) == value]
    tried = [
        a
        for r in results
        for a in r.attempts
        if a.executed and a.item >= 0 and getattr(r.items[a.item], field) == value
    ]
    return {
        **success(sum(a.success for a in tried), len(tried)),
        **clearance([(sum(item.cleared for item in items), len(items))]),
        "pd_mm": spread([a.pd_mm for a in tried], DEEP_MM),
        "pv_mm3": spread([a.pv_mm3 for a in tried]),
    }


def losses(results: Sequence[SceneResult]) -> list[dict[str, Any]]:
    """What was not lifted or took more than one attempt, per object: the most often left first, then most failures."""
    rows: dict[str, dict[str, Any]] = {}
    for r in results:
        for number, item in enumerate(r.items):
            new = {"object": item.name, "shape_class": item.shape_class, "shown": 0, "left": 0, "failed": 0}
            row = rows.setdefault(item.name, {**new, "kinds": Counter(), "ends": Counter()})
            ends = [a.outcome for a in r.attempts if a.item == number and a.executed and not a.success]
            row["shown"] += 1
            row["left"] += not item.cleared
            row["failed"] += len(ends)
            row["kinds"][item.kind] += 1
            row["ends"].update(ends or ([] if item.cleared else [NO_GRASP]))
    lost = (row for row in rows.values() if row["ends"])
    return sorted(lost, key=lambda row: (-row["left"], -row["failed"], row["object"]))


def summarise(results: Sequence[SceneResult]) -> dict[str, Any]:
    """All numbers of finished scenes; rates in [0, 1], times in seconds.

    SR counts executed attempts (the paper's definition); "no grasp found" is no attempt, but its objects count
    against CR. Nor is a push one.
    """
    attempts = [a for r in results for a in r.attempts]
    tried = [a for a in attempts if a.executed]
    counted = Counter(a.outcome for a in attempts)

    def rate(of: Sequence[AttemptRecord]) -> dict[str, Any]:
        return success(sum(a.success for a in of), len(of))

    made_of = {item.material for r in results for item in r.items} | {OPAQUE}
    materials = [name for name in MATERIALS if name in made_of and len(made_of) > 1]
    by_material = {name: _of_items(results, "material", name) for name in materials}
    poses = [[getattr(a, name) for a in tried] for name in ("position", "rotation", "pre_grasp", "grasp")]
    return {
        **clearance([(r.cleared, r.objects) for r in results]),
        **rate(tried),
        "per_class": {name: rate([a for a in tried if a.shape_class == name]) for name in SHAPE_CLASSES},
        "per_kind": {kind: _of_items(results, "kind", kind) for kind in KINDS},
        **({"per_material": by_material} if by_material else {}),
        "losses": losses(results),
        "pushes": sum(a.pushed for a in attempts),
        "level_pinches": rate([a for a in tried if a.source == "level_pinch"]),
        "failures": {name: counted[name] for name in FAILURES},
        "pd_mm": spread([a.pd_mm for a in tried], DEEP_MM),
        "pv_mm3": spread([a.pv_mm3 for a in tried]),
        "pd_closed_mm": spread([a.pd_closed_mm for a in tried], DEEP_MM),
        "pv_closed_mm3": spread([a.pv_closed_mm3 for a in tried]),
        "diversity": diversity(*poses) if len(tried) > 1 else None,
        "time_s": times(attempts),
    }

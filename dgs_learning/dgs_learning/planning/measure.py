"""Measures the pick planner scene by scene, keeps one record per scene, and sums them up."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.paths import PathSettings
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.pick_types import HOME, OPEN_HAND, PickAnswer
from dgs_learning.planning.baseline import Baseline
from dgs_learning.planning.bullet_check import check_pick
from dgs_learning.planning.cases import PickCase

Record = dict[str, Any]


def thorough(planner: PickPlanner) -> PickPlanner:
    """The exhaustive search: every candidate, every IK branch, every state over the bin, 3 s of OMPL per path."""
    settings = replace(
        planner.settings,
        time_limit=600.0,
        sampled_goals=8,
        release_tries=96,
        path=PathSettings(timeout=3.0),
    )
    return PickPlanner(planner.ik, settings, planner.scene_settings, planner.limits)


class _Clock:
    def __init__(self) -> None:
        self.wall_ms = self.processor_ms = 0.0

    @contextmanager
    def running(self) -> Iterator[None]:
        wall, processor = time.perf_counter(), time.process_time()
        yield
        self.wall_ms = round((time.perf_counter() - wall) * 1e3, 2)
        self.processor_ms = round((time.process_time() - processor) * 1e3, 2)


def measure_scene(case: PickCase, planner: PickPlanner) -> Record:
    """Plan a pick from home, search exhaustively, run the baseline, and drive the plan through PyBullet.

    Args:
        case: the cell.
        planner: with its shapes loaded (a first plan takes longer).
    """
    clock = _Clock()
    with clock.running():
        cloud = ObstacleCloud.from_points(case.cloud)
        answer = planner.plan(HOME, OPEN_HAND, case.candidates, cloud)
    record: Record = {
        "scene": case.number,
        "objects": len(case.objects),
        "candidates": len(case.candidates),
        "plan": _outcome(answer, clock),
        "best_reachable": _best_reachable(planner, case, cloud, answer),
        "baseline": {name: _timed_baseline(planner, case, name) for name in ("to_stand_off", "whole_pick")},
    }
    if answer.plan is not None:
        record["check"] = asdict(check_pick(case.objects, answer.plan, HOME))
    return record


def _outcome(answer: PickAnswer, clock: _Clock) -> Record:
    chosen = answer.plan
    return {
        "index": None if chosen is None else chosen.candidate.index,
        "duration_s": None if chosen is None else round(chosen.duration, 3),
        "rejections": dict(Counter(rejection.code.name for rejection in answer.rejections)),
        "wall_ms": clock.wall_ms,
        "processor_ms": clock.processor_ms,
    }


def _best_reachable(
    planner: PickPlanner, case: PickCase, cloud: ObstacleCloud, answer: PickAnswer
) -> int | None:
    """Index of the best-scored candidate that the exhaustive search reaches; the planner's own choice counts."""
    chosen = None if answer.plan is None else answer.plan.candidate.index
    better = case.candidates[:chosen]
    if not better:
        return chosen
    plan = thorough(planner).plan(HOME, OPEN_HAND, better, cloud).plan
    return chosen if plan is None else plan.candidate.index


def _timed_baseline(planner: PickPlanner, case: PickCase, name: str) -> Record:
    clock = _Clock()
    with clock.running():
        baseline = Baseline(planner.ik, planner.settings, ObstacleCloud.from_points(case.cloud))
        plan: Callable[..., int | None] = getattr(baseline, name)
        index = plan(HOME, case.candidates)
    return {"index": index, "wall_ms": clock.wall_ms, "processor_ms": clock.processor_ms}


def append_record(file: Path, record: Record) -> None:
    """Add a line to a file of records; it is on the disk when this returns."""
    with file.open("a", encoding="utf-8") as out:
        out.write(json.dumps(record) + "\n")
        out.flush()
        os.fsync(out.fileno())


def load_records(file: Path) -> list[Record]:
    """Records by scene; a last line that was cut off by a kill is left out."""
    if not file.is_file():
        return []
    lines = file.read_text(encoding="utf-8").split("\n")
    records = [json.loads(line) for line in lines[:-1]]
    return sorted(records, key=lambda record: record["scene"])


def repair(file: Path) -> None:
    """Cut off the rest of a line that was not written to its end."""
    if file.is_file():
        text = file.read_text(encoding="utf-8")
        file.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")


def summarise(records: Sequence[Record]) -> Record:
    """Figures of all scenes.

    Scenes without any candidate are counted and left out of everything else.
    """
    tried = [record for record in records if record["candidates"]]
    plans = [record["plan"] for record in tried]
    reachable = [record for record in tried if record["best_reachable"] is not None]
    found = [record for record in reachable if record["plan"]["index"] is not None]
    best = [record for record in found if record["plan"]["index"] == record["best_reachable"]]
    rejections: Counter[str] = Counter()
    for plan in plans:
        rejections.update(plan["rejections"])
    return {
        "revisions": sorted({record.get("revision", "unknown") for record in records}),
        "scenes": len(records),
        "scenes_without_candidates": len(records) - len(tried),
        "candidates_per_scene": _spread([record["candidates"] for record in tried]),
        "planning": {
            "processor_ms": _spread([plan["processor_ms"] for plan in plans]),
            "wall_ms": _spread([plan["wall_ms"] for plan in plans]),
            "motion_s": _spread([plan["duration_s"] for plan in plans if plan["duration_s"] is not None]),
        },
        "reachable_scenes": len(reachable),
        "found": len(found),
        "share_found": _share(len(found), len(reachable)),
        "share_best_scored": _share(len(best), len(reachable)),
        "rejected_candidates": dict(rejections.most_common()),
        "baseline": {name: _baseline(tried, name) for name in ("to_stand_off", "whole_pick")},
        "check": _checks([record["check"] for record in tried if "check" in record]),
    }


def _baseline(records: Sequence[Record], name: str) -> Record:
    rows = [record["baseline"][name] for record in records]
    return {
        "solved": sum(row["index"] is not None for row in rows),
        "processor_ms": _spread([row["processor_ms"] for row in rows]),
        "wall_ms": _spread([row["wall_ms"] for row in rows]),
    }


def _checks(checks: Sequence[Record]) -> Record:
    contacts: Counter[str] = Counter()
    for check in checks:
        contacts.update(_anonymous(key) for key in check["collisions"])
    return {
        "picks": len(checks),
        "states": sum(check["states"] for check in checks),
        "picks_with_collision": sum(bool(check["collisions"]) for check in checks),
        "collisions": dict(contacts.most_common()),
        "deepest_mm": round(
            1e3 * max((d for c in checks for _, d in c["collisions"].values()), default=0.0), 2
        ),
        "position_violations": sum(check["position_violations"] for check in checks),
        "velocity_violations": sum(check["velocity_violations"] for check in checks),
        "largest_velocity_share": round(max((c["velocity_ratio"] for c in checks), default=0.0), 4),
        "largest_acceleration_share": round(max((c["acceleration_ratio"] for c in checks), default=0.0), 4),
        "largest_gap_rad": max((check["gap"] for check in checks), default=0.0),
    }


def _anonymous(contact: str) -> str:
    """`stage: a - object bottle_3` without the object's name."""
    head, _, last = contact.rpartition(" - ")
    return f"{head} - {'object' if last.startswith('object ') else last}"


def _spread(values: Sequence[float]) -> Record:
    if not values:
        return {}
    row = np.asarray(values, dtype=np.float64)
    return {
        "median": round(float(np.median(row)), 2),
        "p95": round(float(np.percentile(row, 95)), 2),
        "largest": round(float(row.max()), 2),
    }


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, 4) if whole else None

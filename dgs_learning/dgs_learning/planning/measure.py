"""Measures the pick planner scene by scene, keeps one record per scene, and sums them up."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import SAME_SCORE, PickPlanner
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import HOME_ARM
from dgs_description.files import atomic_write
from dgs_description.hand import HAND
from dgs_description.paths import revision
from dgs_description.stage_clock import StageClock
from dgs_learning.planning.baseline import Baseline
from dgs_learning.planning.bullet_check import check_pick
from dgs_learning.planning.cases import PickCase

Record = dict[str, Any]
T = TypeVar("T")

BASELINES = ("to_stand_off", "whole_pick")
"""Methods of `Baseline`."""


def thorough(planner: PickPlanner) -> PickPlanner:
    """The exhaustive search: every candidate, every IK branch, every state over the bin, 3 s of OMPL per path."""
    more = {"planning_time": 600.0, "sampled_goals": 8, "release_tries": 96, "path_time": 3.0}
    return replace(planner, settings=replace(planner.settings, **more))  # type: ignore[arg-type]


def measure_scene(case: PickCase, planner: PickPlanner) -> Record:
    """Plan a pick from home, search exhaustively, run the baseline, and drive the plan through PyBullet.

    The planner has its shapes loaded: a first plan takes longer.
    """
    situation = seen_from_home(case)
    answer, times = _timed(lambda: planner.plan(seen_from_home(case), case.grasps))
    index = None if answer.plan is None else answer.plan.index
    record: Record = {
        "scene": case.number,
        "objects": len(case.objects),
        "candidates": len(case.grasps),
        "plan": {
            "index": index,
            "duration_s": None if answer.plan is None else round(answer.plan.duration, 3),
            "rejections": dict(Counter(rejection.code.name for rejection in answer.rejections)),
            **times,
        },
        "best_reachable": index,
        "baseline": {name: _baseline_record(planner, case, name) for name in BASELINES},
    }
    better = case.grasps[:index]
    if len(better):
        best = thorough(planner).plan(situation, better).plan
        record["best_reachable"] = index if best is None else best.index
    if index is not None:
        given_up = case.grasps.score[record["best_reachable"]] - case.grasps.score[index]
        record["plan"]["score_given_up"] = round(float(given_up), 4)
    if answer.plan is not None:
        record["check"] = asdict(check_pick(case.objects, answer.plan, HOME_ARM))
    return record


def seen_from_home(case: PickCase) -> ArmSituation:
    """The arm at home, and what the camera saw as obstacles."""
    seen = without_robot(case.cloud, HOME_ARM, HAND.open_hand)
    return ArmSituation(HOME_ARM, HAND.open_hand, cloud=ObstacleCloud.from_points(seen))


def _baseline_record(planner: PickPlanner, case: PickCase, name: str) -> Record:
    index, times = _timed(lambda: getattr(Baseline(planner, seen_from_home(case)), name)(case.grasps))
    return {"index": index, **times}


def _timed(work: Callable[[], T]) -> tuple[T, dict[str, float]]:
    """The result, and the time in milliseconds."""
    clocks = {"wall_ms": StageClock(), "processor_ms": StageClock(time.process_time)}
    result = work()
    return result, {name: round(clock.finish()["total"] * 1e3, 2) for name, clock in clocks.items()}


def measure_missing(folder: Path, numbers: Iterable[int], case_of: Callable[[int], PickCase]) -> None:
    """Measure the scenes that have no record in the folder yet, one file each."""
    planner, made_by = PickPlanner(), revision()
    planner.plan_to_bin(ArmSituation(HOME_ARM, HAND.open_hand))  # loads what is loaded once
    for number in numbers:
        file = folder / f"scene_{number:04d}.json"
        if file.is_file():
            continue
        case = case_of(number)
        record = measure_scene(case, planner) if len(case.grasps) else {"scene": number, "candidates": 0}
        with atomic_write(file, "w") as out:
            out.write(json.dumps({"revision": made_by, **record}) + "\n")


def load_records(folder: Path) -> list[Record]:
    """Records of a run by scene."""
    return [json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("scene_*.json"))]


def summarise(records: Sequence[Record]) -> Record:
    """Figures of all scenes.

    Scenes without any candidate are counted and left out of everything else.
    """
    tried = [record for record in records if record["candidates"]]
    plans = [record["plan"] for record in tried]
    reachable = [record for record in tried if record["best_reachable"] is not None]
    found = [record for record in reachable if record["plan"]["index"] is not None]
    best = [record for record in found if record["plan"]["score_given_up"] <= SAME_SCORE]
    rejections = sum((Counter(plan["rejections"]) for plan in plans), Counter())
    return {
        "revisions": sorted({record.get("revision", "unknown") for record in records}),
        "scenes": len(records),
        "scenes_without_candidates": len(records) - len(tried),
        "planning": {
            "processor_ms": _spread([plan["processor_ms"] for plan in plans]),
            "wall_ms": _spread([plan["wall_ms"] for plan in plans]),
        },
        "reachable_scenes": len(reachable),
        "found": len(found),
        "share_found": _share(len(found), len(reachable)),
        "share_as_good": _share(len(best), len(reachable)),
        "rejected_candidates": dict(rejections.most_common()),
        "baseline": {name: _baseline(tried, name) for name in BASELINES},
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
    contacts = Counter(_anonymous(key) for check in checks for key in check["collisions"])
    deepest = max((depth for check in checks for _, depth in check["collisions"].values()), default=0.0)
    return {
        "picks": len(checks),
        "states": sum(check["states"] for check in checks),
        "picks_with_collision": sum(bool(check["collisions"]) for check in checks),
        "collisions": dict(contacts.most_common()),
        "deepest_mm": round(1e3 * deepest, 2),
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
    shares = np.percentile(np.asarray(values, dtype=np.float64), (50, 95, 100)).round(2).tolist()
    return dict(zip(("median", "p95", "largest"), shares, strict=True))


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, 4) if whole else None

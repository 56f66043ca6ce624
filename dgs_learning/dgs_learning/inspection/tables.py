"""Counts of a dataset file: objects, grasps and scenes, per class and finger pattern, beside the paper's Table I."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_learning.dataset import GraspDataset
from dgs_learning.inspection.coverage import LOW, coverage
from dgs_learning.objects.catalogue import SCALES, TRAIN_COUNTS, train_catalogue
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

PATTERNS = (5, 3, 2)
PAPER = {
    "cuboid": (46.652, 0.0, 0.0),
    "cylinder": (23.147, 0.0, 0.0),
    "stick": (18.031, 3.366, 0.231),
    "sphere": (4.123, 2.596, 0.0),
    "bowl": (1.178, 0.231, 0.034),
}
"""Table I of the paper: share of all grasps per class with 5, 3 and 2 fingers [%]."""
NOT_TRIED = "not tried yet"


def base_name(name: str) -> str:
    """Name of the object without its scale, e.g. "bottle_001" of "bottle_001@1.10"."""
    return name.split("@")[0]


def _by_pattern(fingers: NDArray) -> dict[str, int]:
    return {str(n): int((fingers == n).sum()) for n in PATTERNS}


def scene_fingers(data: GraspDataset) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of fingers and object of every scene grasp, (G,) each."""
    fingers, owner = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for scene in data.scenes:
        objects = scene.objects[scene.instance]
        fingers.append(data.fingers[data.first[objects] + scene.grasp])
        owner.append(objects)
    return np.concatenate(fingers), np.concatenate(owner)


def describe(data: GraspDataset) -> dict[str, Any]:
    """All counts; keys objects, object_scales, stage1_grasps, scenes, scene_grasps, by_class and more."""
    covered = coverage(data)
    counts = np.diff(data.first)
    owner = np.repeat(np.arange(len(data.objects)), counts)
    classes = np.array([o.shape_class for o in data.objects])
    bases = np.array([base_name(o.name) for o in data.objects])
    in_scene, scene_owner = scene_fingers(data)
    by_class: dict[str, Any] = {}
    for name in SHAPE_CLASSES:
        mine = classes == name
        stage1 = _by_pattern(data.fingers[mine[owner]])
        scene = _by_pattern(in_scene[mine[scene_owner]])
        by_class[name] = {
            "objects": len(set(bases[mine])),
            "object_scales": int(mine.sum()),
            "stage1_grasps": stage1,
            "scene_grasps": scene,
            "scene_grasps_percent": {n: _percent(k, len(in_scene)) for n, k in scene.items()},
            "in_scenes": covered[name],
            "paper": {
                "objects": TRAIN_COUNTS[name],
                "percent": {str(n): share for n, share in zip(PATTERNS, PAPER[name], strict=True)},
            },
        }
    without = without_grasps(data)
    return {
        "objects": len(set(bases)),
        "object_scales": len(data.objects),
        "stage1_grasps": len(data.position),
        "stage1_uniform": int(data.uniform.sum()),
        "scenes": len(data.scenes),
        "objects_per_scene": float(np.mean([len(s.objects) for s in data.scenes])) if data.scenes else 0.0,
        "scene_grasps": len(in_scene),
        "scene_grasps_turned_by_symmetry": int(sum((s.symmetry > 0).sum() for s in data.scenes)),
        "by_class": by_class,
        "object_scales_without_grasps": {reason: len(names) for reason, names in without.items()},
        "without_grasps": without,
    }


def without_grasps(data: GraspDataset) -> dict[str, list[str]]:
    """Object-scales of the training catalogue that have no grasp, by reason."""
    reasons: dict[str, list[str]] = {}
    for k in np.flatnonzero(np.diff(data.first) == 0):
        reasons.setdefault(_reason(data, int(k)), []).append(data.objects[k].name)
    there = {o.name for o in data.objects}
    catalogue = train_catalogue()
    if {base_name(name) for name in there} <= {o.name for o in catalogue}:
        wanted = [o.scaled(s).name for o in catalogue for s in SCALES]
        missing = [name for name in wanted if name not in there]
        if missing:
            reasons[NOT_TRIED] = missing
    return reasons


def _reason(data: GraspDataset, k: int) -> str:
    if data.drawn is None or data.trials is None:
        return "none found"
    if data.trials[k] == 0:
        return "no candidate was free of collision and closed around it"
    return "no simulated candidate held"


def _percent(part: int, whole: int) -> float:
    return round(100.0 * part / max(1, whole), 3)


def as_text(summary: dict[str, Any]) -> str:
    """The counts as a readable table."""
    lines = [
        f"{summary['objects']} objects, {summary['object_scales']} object-scales, "
        f"{summary['stage1_grasps']} stage-1 grasps ({summary['stage1_uniform']} drawn uniformly)",
        f"{summary['scenes']} scenes with {summary['objects_per_scene']:.1f} objects on average, "
        f"{summary['scene_grasps']} scene grasps "
        f"({summary['scene_grasps_turned_by_symmetry']} turned by a symmetry)",
        "",
        "class      objects  scales   stage-1 grasps       scene grasps         share of scene grasps [%]  Table I [%]",
        "         own/paper          5 / 3 / 2 fingers    5 / 3 / 2 fingers    5 / 3 / 2                  5 / 3 / 2",
    ]
    for name, row in summary["by_class"].items():
        lines.append(
            f"{name:9s} {row['objects']:4d}/{row['paper']['objects']:<4d} {row['object_scales']:6d}   "
            f"{_cell(row['stage1_grasps'].values()):20s} {_cell(row['scene_grasps'].values()):20s} "
            f"{_cell(row['scene_grasps_percent'].values()):26s} {_cell(row['paper']['percent'].values())}"
        )
    lines += ["", f"in the scenes, all / lower than {LOW * 1e3:.0f} mm: objects, and those with a grasp [%]"]
    for name, row in summary["by_class"].items():
        there = row["in_scenes"]
        shares = [_percent(there[f"{low}graspable"], there[f"{low}instances"]) for low in ("", "low_")]
        lines.append(f"{name:9s} {there['instances']} / {there['low_instances']}   {_cell(shares)}")
    for reason, count in summary["object_scales_without_grasps"].items():
        lines.append(f"without grasps: {count} object-scales, {reason}")
    return "\n".join(lines)


def _cell(values: Sequence[float]) -> str:
    return " / ".join(f"{v:.2f}" if isinstance(v, float) else str(v) for v in values)

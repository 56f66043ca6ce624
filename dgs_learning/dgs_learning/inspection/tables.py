"""Counts of a dataset file: objects, grasps and scenes, per class and finger pattern, beside the paper's Table I."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_learning.dataset import UNIFORM, GraspDataset
from dgs_learning.evaluation.report.templates import render
from dgs_learning.objects.catalogue import SCALES, TRAIN_COUNTS, make_catalogue, name_and_scale
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

PATTERNS = (5, 4, 3, 2)
LOW = 0.03
"""What lies lower than this is thin: fingertips 22 mm wide all but scrape the table to reach its sides [m]."""
IN_SCENES = ("instances", "graspable", "low_instances", "low_graspable")
PAPER = {
    "cuboid": (46.652, 0.0, 0.0, 0.0),
    "cylinder": (23.147, 0.0, 0.0, 0.0),
    "stick": (18.031, 0.0, 3.366, 0.231),
    "sphere": (4.123, 0.0, 2.596, 0.0),
    "bowl": (1.178, 0.0, 0.231, 0.034),
}
"""Table I of the paper: share of all grasps per class with 5, 4, 3 and 2 fingers [%]; four pinch level here alone."""
NOT_TRIED = "not tried yet"
NOT_FREE = "no candidate was free of collision and closed around it"
NOT_HELD = "no simulated candidate held"


def coverage(data: GraspDataset) -> dict[str, dict[str, int]]:
    """Per shape class: objects in the scenes and those of them with a grasp, all and those lower than `LOW`.

    Returns:
        class -> {"instances", "graspable", "low_instances", "low_graspable"}, counts.
    """
    counted = {name: dict.fromkeys(IN_SCENES, 0) for name in SHAPE_CLASSES}
    for scene in data.scenes:
        graspable = np.bincount(scene.instance, minlength=len(scene.objects)) > 0
        for number, T, has in zip(scene.objects, scene.T_table_object, graspable, strict=True):
            model = data.objects[number]
            low = float(np.ptp(model.vertices @ T[2, :3])) < LOW
            for key, applies in zip(IN_SCENES, (True, has, low, low and has), strict=True):
                counted[model.shape_class][key] += int(applies)
    return counted


def _by_pattern(fingers: NDArray) -> dict[str, int]:
    return {str(n): int((fingers == n).sum()) for n in PATTERNS}


def describe(data: GraspDataset) -> dict[str, Any]:
    """All counts; keys objects, object_scales, stage1_grasps, scenes, scene_grasps, by_class and more."""
    covered, owner = coverage(data), data.owner
    classes = np.array([o.shape_class for o in data.objects])
    bases = np.array([name_and_scale(o.name)[0] for o in data.objects])
    row = np.concatenate([np.zeros(0, np.int64), *(data.rows(scene) for scene in data.scenes)])
    by_class: dict[str, Any] = {}
    for name in SHAPE_CLASSES:
        mine = classes == name
        scene = _by_pattern(data.fingers[row[mine[owner[row]]]])
        by_class[name] = {
            "objects": len(set(bases[mine])),
            "object_scales": int(mine.sum()),
            "stage1_grasps": _by_pattern(data.fingers[mine[owner]]),
            "scene_grasps": scene,
            "scene_grasps_percent": {n: round(100.0 * k / max(1, len(row)), 3) for n, k in scene.items()},
            "in_scenes": covered[name],
            "paper": {
                "objects": TRAIN_COUNTS[name],
                "percent": dict(zip(map(str, PATTERNS), PAPER[name], strict=True)),
            },
        }
    without = without_grasps(data)
    low = np.array([np.ptp(o.vertices, axis=0).min() < LOW for o in data.objects], dtype=bool)
    return {
        "objects": len(set(bases)),
        "object_scales": len(data.objects),
        "low_object_scales": int(low.sum()),
        "low_object_scales_with_grasps": int((low & (np.diff(data.first) > 0)).sum()),
        "stage1_grasps": len(data.grasps),
        "stage1_uniform": int((data.grasps.source == UNIFORM).sum()),
        "scenes": len(data.scenes),
        "objects_per_scene": float(np.mean([len(s.objects) for s in data.scenes])) if data.scenes else 0.0,
        "scene_grasps": len(row),
        "scene_grasps_turned_by_symmetry": int(sum((s.symmetry > 0).sum() for s in data.scenes)),
        "by_class": by_class,
        "object_scales_without_grasps": {reason: len(names) for reason, names in without.items()},
        "without_grasps": {reason: names for reason, names in without.items() if reason != NOT_TRIED},
    }


def without_grasps(data: GraspDataset) -> dict[str, list[str]]:
    """Object-scales of the training catalogue that have no grasp, by reason."""
    reasons: dict[str, list[str]] = {}
    for k in np.flatnonzero(np.diff(data.first) == 0):
        reasons.setdefault(NOT_HELD if data.trials[k] else NOT_FREE, []).append(data.objects[k].name)
    there = {o.name for o in data.objects}
    catalogue = make_catalogue("train")
    if {name_and_scale(name)[0] for name in there} <= {o.name for o in catalogue}:
        missing = [name for o in catalogue for s in SCALES if (name := o.scaled(s).name) not in there]
        reasons |= {NOT_TRIED: missing} if missing else {}
    return reasons


def as_text(summary: dict[str, Any]) -> str:
    """The counts as a readable table."""
    return render("dataset.txt", s=summary, low_mm=LOW * 1e3)

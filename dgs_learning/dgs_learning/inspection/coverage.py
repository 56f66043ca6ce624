"""How many of the objects that lie in the scenes have a feasible grasp at all, by class and by how high they lie."""

from __future__ import annotations

from typing import Any

import numpy as np

from dgs_learning.dataset import GraspDataset
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

LOW = 0.03
"""What lies lower than this is thin: fingertips 22 mm wide all but scrape the table to reach its sides [m]."""


def coverage(data: GraspDataset) -> dict[str, Any]:
    """Per shape class: objects in the scenes and those of them with a grasp, all and those lower than `LOW`.

    Returns:
        class -> {"instances", "graspable", "low_instances", "low_graspable"}, counts.
    """
    rows = {
        name: dict.fromkeys(("instances", "graspable", "low_instances", "low_graspable"), 0)
        for name in SHAPE_CLASSES
    }
    for scene in data.scenes:
        has = np.bincount(scene.instance, minlength=len(scene.objects)) > 0
        for k, (number, T) in enumerate(zip(scene.objects, scene.T_table_object, strict=True)):
            model = data.objects[number]
            low = float(np.ptp(model.vertices @ T[2, :3])) < LOW
            row = rows[model.shape_class]
            row["instances"] += 1
            row["graspable"] += int(has[k])
            row["low_instances"] += int(low)
            row["low_graspable"] += int(low and has[k])
    return rows

"""A target, what stands beside it, and grasps at it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_learning.objects import shapes
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.world.scenes import PlacedObject
from tests.support.grasps import top_grasps

PLACE = np.array([0.30, 0.10])
AT_HOME = ArmSituation(HOME_ARM, HAND.open_hand)


def grasps_at(*places: tuple[float, ...]) -> GraspSet:
    """From above, aimed 4 cm below the TCP."""
    grasps = top_grasps(np.array(places))
    return replace(grasps, reference_point=grasps.position - (0, 0, 0.04))


def box(name: str, size: tuple[float, float, float], x: float, y: float, z: float) -> PlacedObject:
    return PlacedObject(
        from_parts(name, "cuboid", name, shapes.box(list(size)), 0.2), transform(position=(x, y, z))
    )


def standing(name: str, size: tuple[float, float, float], x: float, y: float) -> PlacedObject:
    item = box(name, size, x, y, 0.0)
    lowest = float(item.model.vertices[:, 2].min())
    return replace(item, pose=transform(position=(x, y, CELL.table_height - lowest)))


TARGET = standing("target", (0.04, 0.04, 0.08), *PLACE)


def record(scene: int, index: int | None, best: int | None, contact: dict | None = None) -> dict[str, Any]:
    """A record as of `measure_scene`."""
    row = {"index": index, "wall_ms": 10.0 * scene, "processor_ms": 5.0 * scene}
    given_up = 0.1 * (index - best) if index is not None and best is not None else None
    checked = {
        "states": 100, "collisions": contact or {}, "position_violations": 0, "velocity_violations": scene,
        "velocity_ratio": 0.5, "acceleration_ratio": 1.0, "gap": 0.0,
    }  # fmt: skip
    return {
        "revision": "abc", "scene": scene, "objects": 4, "candidates": 60, "best_reachable": best,
        "plan": row | {
            "duration_s": 8.0 if index is not None else None, "rejections": {"OUT_OF_REACH": scene},
            "score_given_up": given_up,
        },
        "baseline": {"to_stand_off": row, "whole_pick": row},
    } | ({"check": checked} if index is not None else {})  # fmt: skip

"""Contact sheets of stored grasps, one page per shape class: the object with the hand around it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import inverse, look_at
from dgs_description.grasp import GraspSet
from dgs_learning.dataset import GraspDataset
from dgs_learning.inspection.sheet import contact_sheet
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.pictures import NO_POINTS, Colour, DrawnHand, Item, Picture, View, draw

TILE = 300
"""Edge of a tile [px]."""
COLUMNS = 5
DISTANCE = 0.75
"""From the camera to the grasp [m]."""
MIN_SPAN, MAX_SPAN = 0.24, 0.34
"""What a tile shows [m]."""
HAND_COLOUR: Colour = (74, 111, 165)
OBJECT: dict[str, Colour] = {
    "cuboid": (226, 149, 84),
    "cylinder": (108, 168, 120),
    "stick": (214, 180, 78),
    "sphere": (205, 104, 98),
    "bowl": (150, 122, 176),
}


def draw_grasp(model: ObjectModel, grasp: GraspSet) -> Picture:
    """One tile: seen across the pinch axis, from the side of thumb and index and a little from below the fingers.

    The hand comes from above, whatever its direction was in the object's frame, which the grasp is in.
    """
    side = np.array([0.42, 0.80, 0.42])
    T_tcp_object = inverse(grasp.pose)
    span = float(np.clip(1.7 * np.linalg.norm(model.bounds[1] - model.bounds[0]), MIN_SPAN, MAX_SPAN))
    focal = TILE * DISTANCE / span
    camera = PinholeCamera.centred(TILE, TILE, focal)
    centre = 0.5 * T_tcp_object[:3, 3] + np.array([0.0, 0.0, -0.025])
    T_tcp_camera = look_at(centre + DISTANCE * side / np.linalg.norm(side), centre, up=(0, 0, -1))
    item = Item(model.mesh, T_tcp_object, OBJECT[model.shape_class])
    hand = DrawnHand(np.eye(4), grasp.grasp_joints, HAND_COLOUR, grasp.active_fingers)
    return draw(NO_POINTS, NO_POINTS, [hand], View(camera, T_tcp_camera), [item])


def choose(data: GraspDataset, shape_class: str, count: int, seed: int) -> list[int]:
    """Grasps of a class: patterns in turn, one per object before a second of the same object."""
    rng = np.random.default_rng([seed, len(shape_class)])
    owner = data.owner.tolist()
    mine = np.array([o.shape_class == shape_class for o in data.objects], dtype=bool)[owner]
    chosen: list[int] = []
    used: Counter[int] = Counter()
    # Those of four and five fingers come last: they fill half of the page, or what there are no others for.
    for fingers, most in (((2,), count // 4), ((3,), count // 4), ((4, 5), count)):
        rows = rng.permutation(np.flatnonzero(mine & np.isin(data.fingers, fingers))).tolist()
        for _ in range(min(most, count - len(chosen), len(rows))):
            chosen.append(min(rows, key=lambda r: used[owner[r]]))
            used[owner[chosen[-1]]] += 1
            rows.remove(chosen[-1])
    return sorted(chosen, key=lambda r: (-data.fingers[r], owner[r]))


def grasp_sheet(path: Path, data: GraspDataset, shape_class: str, count: int = 15, seed: int = 0) -> bool:
    """Draw the page of a class; False, and no page, if it has no grasps."""
    rows = choose(data, shape_class, count, seed)
    if not rows:
        return False
    owner = data.owner
    tiles = [draw_grasp(data.objects[owner[row]], data.grasps[row]) for row in rows]
    captions = [
        f"{data.objects[owner[row]].name}\n{data.fingers[row]} fingers, {data.grasps.source[row]} draw, grasp {row}"
        for row in rows
    ]
    mine = np.array([o.shape_class == shape_class for o in data.objects])
    share = f"{len(rows)} of {mine[owner].sum()} grasps of {mine.sum()} object-scales"
    note = f"{share}; the palm is drawn as glass, idle fingers pale"
    contact_sheet(path, tiles, captions, COLUMNS, 2.0, f"Stage 1: {shape_class}\n{note}")
    return True

"""Contact sheets of stored grasps, one page per shape class: the object with the hand around it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import inverse, look_at, transform
from dgs_learning.dataset import GraspDataset
from dgs_learning.inspection.sheet import contact_sheet
from dgs_sim_bridge.render.d455 import CameraModel
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.pictures import NO_POINTS, Colour, DrawnHand, Item, Picture, View, draw

Array = NDArray[np.float64]

TILE = 300
"""Edge of a tile [px]."""
COLUMNS = 5
DISTANCE = 0.75
"""From the camera to the grasp [m]."""
MIN_SPAN, MAX_SPAN = 0.24, 0.34
"""What a tile shows [m]."""
HAND: Colour = (74, 111, 165)
OBJECT: dict[str, Colour] = {
    "cuboid": (226, 149, 84),
    "cylinder": (108, 168, 120),
    "stick": (214, 180, 78),
    "sphere": (205, 104, 98),
    "bowl": (150, 122, 176),
}
ORDER = (5, 3, 2)


def draw_grasp(model: ObjectModel, T_object_tcp: Array, joints: Array, active: NDArray[np.bool_]) -> Picture:
    """One tile: seen across the pinch axis, from the side of thumb and index and a little from below the fingers.

    The hand comes from above, whatever its direction was in the object's frame.
    """
    side = np.array([0.42, 0.80, 0.42])
    T_tcp_object = inverse(T_object_tcp)
    span = float(np.clip(1.9 * np.linalg.norm(model.bounds[1] - model.bounds[0]) * 0.9, MIN_SPAN, MAX_SPAN))
    focal = TILE * DISTANCE / span
    camera = CameraModel(TILE, TILE, focal, focal, (TILE - 1) / 2, (TILE - 1) / 2)
    centre = 0.5 * T_tcp_object[:3, 3] + np.array([0.0, 0.0, -0.025])
    T_tcp_camera = look_at(centre + DISTANCE * side / np.linalg.norm(side), centre, up=(0, 0, -1))
    item = Item((model.vertices, model.faces), T_tcp_object, OBJECT[model.shape_class])
    hand = DrawnHand(np.eye(4), joints, HAND, active)
    return draw(NO_POINTS, NO_POINTS, [hand], View(camera, T_tcp_camera), [item])


def choose(data: GraspDataset, shape_class: str, count: int, seed: int) -> list[int]:
    """Grasps of a class: patterns in turn, one per object before a second of the same object."""
    rng = np.random.default_rng([seed, len(shape_class)])
    owner = np.repeat(np.arange(len(data.objects)), np.diff(data.first))
    mine = np.array([o.shape_class == shape_class for o in data.objects], dtype=bool)[owner]
    chosen: list[int] = []
    used: dict[int, int] = {}
    # Five-finger grasps fill half of the page; the others get the rest, as far as there are any.
    wanted = {5: count - 2 * (count // 4), 3: count // 4, 2: count // 4}
    for pattern in ORDER[::-1]:
        rows = rng.permutation(np.flatnonzero(mine & (data.fingers == pattern)))
        room = wanted[pattern] if pattern != 5 else count - len(chosen)
        for _ in range(min(room, len(rows))):
            pick = min(rows, key=lambda r: used.get(int(owner[r]), 0))
            rows = rows[rows != pick]
            used[int(owner[pick])] = used.get(int(owner[pick]), 0) + 1
            chosen.append(int(pick))
    return sorted(chosen, key=lambda r: (-data.fingers[r], owner[r]))


def grasp_sheet(data: GraspDataset, shape_class: str, count: int = 15, seed: int = 0) -> Picture | None:
    """Page of a class; None if it has no grasps."""
    rows: Sequence[int] = choose(data, shape_class, count, seed)
    if not rows:
        return None
    owner = np.repeat(np.arange(len(data.objects)), np.diff(data.first))
    tiles, captions = [], []
    for row in rows:
        model = data.objects[owner[row]]
        T_object_tcp = transform(data.rotation[row], data.position[row])
        tiles.append(draw_grasp(model, T_object_tcp, data.joints[row], data.active[row]))
        drawn = "uniform draw" if data.uniform[row] else "guided draw"
        captions.append((model.name, f"{data.fingers[row]} fingers, {drawn}, grasp {row}"))
    mine = [o.shape_class == shape_class for o in data.objects]
    total = int(np.diff(data.first)[mine].sum())
    note = f"{len(rows)} of {total} grasps of {sum(mine)} object-scales; the palm is drawn as glass, idle fingers pale"
    return contact_sheet(tiles, captions, COLUMNS, f"Stage 1: {shape_class}", note)

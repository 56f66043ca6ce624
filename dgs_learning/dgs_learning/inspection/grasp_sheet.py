"""Contact sheets of stored grasps, one page per shape class: the object with the hand around it."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import inverse, look_at, transform
from dgs_learning.dataset import GraspDataset
from dgs_learning.pictures.shading import Colour, Item, Picture, draw
from dgs_learning.pictures.sheet import contact_sheet
from dgs_sim_bridge.render.meshes import hand_parts
from dgs_sim_bridge.render.object_model import ObjectModel

Array = NDArray[np.float64]

TILE = 300
"""Edge of a tile [px]."""
COLUMNS = 5
DISTANCE = 0.75
"""From the camera to the grasp [m]."""
MIN_SPAN, MAX_SPAN = 0.24, 0.34
"""What a tile shows [m]."""
FINGER: Colour = (74, 111, 165)
THUMB: Colour = (53, 83, 130)
IDLE: Colour = (176, 186, 198)
PALM: Colour = (122, 144, 173)
OBJECT: dict[str, Colour] = {
    "cuboid": (226, 149, 84),
    "cylinder": (108, 168, 120),
    "stick": (214, 180, 78),
    "sphere": (205, 104, 98),
    "bowl": (150, 122, 176),
}
ORDER = (5, 3, 2)


def distinct_colours(count: int) -> list[Colour]:
    """`count` colours that can be told apart, by golden-ratio steps of the hue."""
    rows = [colorsys.hsv_to_rgb((0.08 + 0.618034 * k) % 1.0, 0.52, 0.86) for k in range(count)]
    return [(255 * r, 255 * g, 255 * b) for r, g, b in rows]


def hand_items(
    T_world_tcp: Array,
    joints: Array,
    active: NDArray[np.bool_],
    colour: Colour = FINGER,
    glass_palm: bool = True,
) -> list[Item]:
    """The hand as things to draw: fingers solid, idle ones pale, the palm as glass.

    Args:
        T_world_tcp: (4, 4) pose.
        joints: (20,) [rad].
        active: (5,).
        colour: of the active fingers; the thumb is darker.
        glass_palm: else the palm is solid.
    """
    items = []
    for part in hand_parts(joints):
        if part.finger < 0:
            paint, glass = PALM if colour is FINGER else colour, glass_palm
        else:
            shade = 0.75 if part.finger == 0 else 1.0
            own = (colour[0] * shade, colour[1] * shade, colour[2] * shade)
            paint, glass = own if active[part.finger] else IDLE, False
        items.append(Item(part.mesh, T_world_tcp @ part.T_tcp_part, paint, glass))
    return items


def draw_grasp(model: ObjectModel, T_object_tcp: Array, joints: Array, active: NDArray[np.bool_]) -> Picture:
    """One tile: seen across the pinch axis, from the side of thumb and index and a little from below the fingers.

    The hand comes from above, whatever its direction was in the object's frame.
    """
    side = np.array([0.42, 0.80, 0.42])
    T_tcp_object = inverse(T_object_tcp)
    span = float(np.clip(1.9 * np.linalg.norm(model.bounds[1] - model.bounds[0]) * 0.9, MIN_SPAN, MAX_SPAN))
    focal = TILE * DISTANCE / span
    camera = PinholeCamera.centred(TILE, TILE, focal)
    centre = 0.5 * T_tcp_object[:3, 3] + np.array([0.0, 0.0, -0.025])
    T_tcp_camera = look_at(centre + DISTANCE * side / np.linalg.norm(side), centre, up=(0, 0, -1))
    items = [Item((model.vertices, model.faces), T_tcp_object, OBJECT[model.shape_class])]
    return draw([*items, *hand_items(np.eye(4), joints, active)], camera, T_tcp_camera)


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

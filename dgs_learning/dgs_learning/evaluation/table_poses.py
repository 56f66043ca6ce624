"""Tables seen from many camera poses, with the camera's noise, and how well `estimate_table` finds them.

A view is drawn from a seed and a number: what stands around the table (its kind), the table's size, and a camera that
looks at a point of the table from 0.3 to 1.5 m away, 0 to 70 degrees from straight down, rolled by any angle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError
from dgs_description.frames import Array, look_at, transform
from dgs_description.table_fit import estimate_table
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import Mesh, box_mesh, render

KINDS = ("whole", "part", "edge", "lid", "shelf", "wall", "robot", "clutter")
"""Whole table; a corner of it; its edge through the picture; a large box on it; a board above it; a wall behind it; a
robot on it; things up to the picture's border."""
DISTANCE, TILT = (0.3, 1.5), (0.0, 70.0)
"""Of the camera to the point it looks at [m], of its axis from straight down [deg]."""
LEAST_SEEN = 0.12
"""Share of the picture's points that show the table; a view with less is drawn again."""
ANGLE_LIMIT, HEIGHT_LIMIT = 0.5, 0.003
"""Errors up to which a table is found [deg, m]."""
NOISE = D455Noise(max_disparity=300.0, bias_rms=0.0)
"""Wide search range, for 0.3 m. No constant disparity offset: it bends the plane for every fit (1.6 mm at 1.5 m)."""


@dataclass(frozen=True)
class TableView:
    """One cloud and the truth.

    Attributes:
        kind: one of `KINDS`.
        distance, tilt: of the camera [m, deg].
        points: (N, 3) float32 in the optical frame [m].
        normal: (3,) of the table in the optical frame.
        seen: (3,) the mean of the table's visible points [m].
    """

    kind: str
    distance: float
    tilt: float
    points: NDArray[np.float32]
    normal: Array
    seen: Array


def draw_view(catalogue: Sequence[ObjectModel], seed: int, number: int) -> TableView:
    """View `number` of a seed; the kinds take turns."""
    kind = KINDS[number % len(KINDS)]
    rng = np.random.default_rng([seed, 203, number])
    while True:
        view = _draw(catalogue, kind, rng)
        if view is not None:
            return view


def _draw(catalogue: Sequence[ObjectModel], kind: str, rng: np.random.Generator) -> TableView | None:
    half = np.array([rng.uniform(0.25, 0.45), rng.uniform(0.35, 0.7)])
    at_edge = kind in ("part", "edge")
    reach = {"part": 0.95, "edge": 1.0}.get(kind, 0.4)
    target = np.array([*rng.uniform(-reach, reach, 2) * half, 0.0])
    if at_edge:
        axis = int(rng.integers(2))
        target[axis] = rng.choice([-1, 1]) * (half[axis] - rng.uniform(0.0, 0.06))
    distance, tilt = float(np.exp(rng.uniform(*np.log(DISTANCE)))), float(rng.uniform(*TILT))
    azimuth, roll = rng.uniform(-np.pi, np.pi, 2)
    aside = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    eye = target + distance * (np.sin(np.deg2rad(tilt)) * aside + [0.0, 0.0, np.cos(np.deg2rad(tilt))])
    T_table_camera = look_at(eye, target, up=(-np.sin(azimuth), np.cos(azimuth), 0.0))
    T_table_camera[:3, :3] @= Rotation.from_euler("z", roll).as_matrix()
    things: list[tuple[Mesh, Array]] = [(box_mesh((*-half, -0.03), (*half, 0.0)), np.eye(4))]
    things += _surroundings(kind, target, aside, distance, rng)
    count = 40 if kind == "clutter" else int(rng.integers(0 if kind == "whole" else 3, 12))
    things += _objects(catalogue, count, half, target, eye, distance, rng)
    image = render([mesh for mesh, _ in things], [pose for _, pose in things], D455, T_table_camera)
    noisy = NOISE.apply(image.depth, D455, rng)
    ideal = D455.all_points(image.depth).astype(np.float64)
    up, eye_height = T_table_camera[2, :3].copy(), T_table_camera[2, 3]
    top = (image.ids == 0).ravel() & (noisy > 0).ravel() & (np.abs(ideal @ up + eye_height) < 1e-4)
    if top.sum() < LEAST_SEEN * max((noisy > 0).sum(), 0.2 * noisy.size):
        return None
    return TableView(kind, distance, tilt, D455.deproject(noisy), up, ideal[top].mean(axis=0))


def _surroundings(
    kind: str, target: Array, aside: Array, distance: float, rng: np.random.Generator
) -> list[tuple[Mesh, Array]]:
    """Meshes that are fixed, with their poses (4, 4); `aside` points from the target to the camera, level."""
    things: list[tuple[Mesh, Array]] = []
    far = transform(Rotation.from_euler("z", np.arctan2(-aside[1], -aside[0])).as_matrix(), target)
    if rng.random() < 0.7:
        floor = -rng.uniform(0.5, 0.9)
        things.append((box_mesh((-3, -3, floor - 0.02), (3, 3, floor)), np.eye(4)))
    if kind == "lid":
        size = np.array([rng.uniform(0.10, 0.2), rng.uniform(0.12, 0.25)]) * min(1.0, distance + 0.2)
        box = box_mesh((*-size, 0.0), (*size, rng.uniform(0.03, 0.15)))
        at = target + 0.6 * distance * np.array([*rng.uniform(-0.3, 0.3, 2), 0.0]) - 0.25 * distance * aside
        things.append((box, transform(Rotation.from_euler("z", rng.uniform(0, 3)).as_matrix(), at)))
    if kind == "shelf":
        size, height = np.array([rng.uniform(0.05, 0.12), rng.uniform(0.2, 0.4)]), rng.uniform(0.15, 0.3)
        things.append((box_mesh((0.2, -size[1], height - 0.02), (0.2 + 2 * size[0], size[1], height)), far))
    if kind == "wall":
        near = rng.uniform(0.1, 0.4)
        things.append((box_mesh((near, -3.0, -1.0), (near + 0.05, 3.0, 1.5)), far))
    if kind == "robot":
        foot = box_mesh((-0.06, -0.06, 0.0), (0.06, 0.06, 0.35))
        arm = box_mesh((-0.05, -0.4, 0.3), (0.05, 0.06, 0.4))
        robot = far @ transform(position=(rng.uniform(0.1, 0.3), rng.uniform(-0.2, 0.2), 0.0))
        things += [(foot, robot), (arm, robot)]
    return things


def _objects(
    catalogue: Sequence[ObjectModel],
    count: int,
    half: Array,
    target: Array,
    eye: Array,
    distance: float,
    rng: np.random.Generator,
) -> list[tuple[Mesh, Array]]:
    """Up to `count` objects that stand on the table where the camera looks, none over another or under the camera."""
    things: list[tuple[Mesh, Array]] = []
    taken = [eye[:2]]
    for _ in range(3 * count):
        spot = target[:2] + rng.uniform(-0.6, 0.6, 2) * distance
        if len(things) == count or (np.abs(spot) > half - 0.04).any():
            continue
        if np.linalg.norm(np.array(taken) - spot, axis=1).min() < 0.09:
            continue
        model = catalogue[int(rng.integers(len(catalogue)))]
        heading = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
        things.append((model.mesh, transform(heading, (*spot, -model.vertices[:, 2].min()))))
        taken.append(spot)
    return things


@dataclass(frozen=True)
class Found:
    """How well a table was found.

    Attributes:
        kind, distance, tilt: of the view.
        angle: error of the normal [deg], height: at the middle of what is seen [m]; infinite where none was found.
        refused: why none was found.
    """

    kind: str
    distance: float
    tilt: float
    angle: float = np.inf
    height: float = np.inf
    refused: str = ""

    @property
    def good(self) -> bool:
        """Both errors are within the limits."""
        return not self.refused and self.angle < ANGLE_LIMIT and self.height < HEIGHT_LIMIT


def find(view: TableView) -> Found:
    """Look for the table of one view."""
    try:
        plane = estimate_table(view.points, np.random.default_rng(0))
    except DgsError as error:
        return Found(view.kind, view.distance, view.tilt, refused=error.message)
    angle = float(np.rad2deg(np.arccos(np.clip(plane.normal @ view.normal, -1.0, 1.0))))
    return Found(view.kind, view.distance, view.tilt, angle, float(abs(plane.heights(view.seen[None])[0])))


def summarise(results: Iterable[Found]) -> dict[str, Any]:
    """Share found, and errors of those that were, by kind, distance and tilt."""
    every = list(results)
    groups = {"all": every} | {kind: [r for r in every if r.kind == kind] for kind in KINDS}
    for low, high in ((0.3, 0.5), (0.5, 0.9), (0.9, 1.5)):
        groups[f"{low} to {high} m"] = [r for r in every if low <= r.distance < high]
    for low, high in ((0, 25), (25, 50), (50, 70)):
        groups[f"tilted by {low} to {high} degrees"] = [r for r in every if low <= r.tilt < high]
    return {name: _group(group) for name, group in groups.items() if group}


def _group(results: Sequence[Found]) -> dict[str, Any]:
    good = [r for r in results if r.good]
    angle, height = ([getattr(r, name) for r in good] or [0.0] for name in ("angle", "height"))
    return {
        "views": len(results),
        "found": len(good),
        "refused": sum(bool(r.refused) for r in results),
        "angle_p95_deg": round(float(np.percentile(angle, 95)), 3),
        "height_p95_mm": round(1e3 * float(np.percentile(height, 95)), 2),
    }

"""Contact sheets of scenes: the table with some of its grasps, the camera's depth image, and the labelled cloud."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import apply, inverse, look_at, transform
from dgs_learning.dataset import GraspDataset, SceneGrasps, TableGrasps
from dgs_learning.inspection.grasp_sheet import distinct_colours, hand_items
from dgs_learning.pictures.shading import BACKGROUND, Item, Picture, draw
from dgs_learning.pictures.sheet import contact_sheet
from dgs_learning.training.labels import CANDIDATE, REFERENCE, LabelSettings, label
from dgs_learning.training.views import TABLE_MESH, ViewSettings
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.raster import render

Array = NDArray[np.float64]

WIDTH, HEIGHT = 480, 360
HANDS = 4
MIN_DISTANCE = 0.11
"""Hands in one picture are at least so far apart [m]."""
_GREY, _BLUE, _RED, _GREEN, _PURPLE = (
    (190, 190, 192),
    (86, 130, 190),
    (214, 60, 52),
    (70, 165, 90),
    (140, 70, 170),
)
"""Table, objects, reference points, candidate points, TCPs: the colours of the paper's figure 4."""


@dataclass(frozen=True)
class Shot:
    """What the depth camera saw: depth (H, W) [m], ids (H, W), pose (4, 4) in the frame *table*."""

    depth: NDArray[np.float32]
    ids: NDArray[np.int16]
    T_table_camera: Array


def _shoot(data: GraspDataset, scene: SceneGrasps, rng: np.random.Generator, azimuth: float) -> Shot:
    elevation = np.deg2rad(48.0)
    direction = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    T_table_camera = look_at(direction, (0, 0, 0.02))
    models = [data.objects[k] for k in scene.objects]
    view = render(
        [(m.vertices, m.faces) for m in models], scene.T_table_object, D455, T_table_camera, table=TABLE_MESH
    )
    return Shot(ViewSettings().noise.apply(view.depth, D455, rng), view.ids, T_table_camera)


def spread_out(position: Array, rng: np.random.Generator, count: int = HANDS) -> list[int]:
    """Up to `count` of (G, 3) positions, drawn at random, at least `MIN_DISTANCE` apart."""
    chosen: list[int] = []
    for k in rng.permutation(len(position)):
        if len(chosen) < count and all(
            np.linalg.norm(position[k] - position[c]) > MIN_DISTANCE for c in chosen
        ):
            chosen.append(int(k))
    return chosen


def _table_picture(
    data: GraspDataset, scene: SceneGrasps, grasps: TableGrasps, rows: list[int], azimuth: float
) -> Picture:
    """Objects and a few hands, shaded, from the side of the camera but closer."""
    focal = 1.45 * WIDTH
    camera = PinholeCamera.centred(WIDTH, HEIGHT, focal)
    direction = np.array([np.cos(azimuth) * 0.8, np.sin(azimuth) * 0.8, 0.72])
    T_table_view = look_at(1.12 * direction / np.linalg.norm(direction) + (0, 0, 0.04), (0, 0, 0.04))
    colours = distinct_colours(len(scene.objects))
    items = [
        Item((data.objects[k].vertices, data.objects[k].faces), T, colour)
        for k, T, colour in zip(scene.objects, scene.T_table_object, colours, strict=True)
    ]
    for row in rows:
        T_table_tcp = transform(grasps.rotation[row], grasps.position[row])
        items += hand_items(T_table_tcp, grasps.joints[row], grasps.active[row])
    return draw(items, camera, T_table_view, table=TABLE_MESH)


def _depth_picture(shot: Shot) -> Picture:
    """Depth with noise in colours from near (yellow) to far (violet), black = none; scaled to the tile."""
    depth = shot.depth
    seen = depth[depth > 0]
    low, high = np.percentile(seen, [0.5, 99.5])
    share = np.clip((high - depth) / max(high - low, 1e-3), 0, 1)
    image = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1].copy()
    image[depth == 0] = 0
    return _fit(image)


def _fit(image: Picture) -> Picture:
    """Cut to the tile's proportions around the middle and scale."""
    height, width = image.shape[:2]
    cut = min(width, round(height * WIDTH / HEIGHT))
    left = (width - cut) // 2
    return cv2.resize(
        np.ascontiguousarray(image[:, left : left + cut]), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA
    )


def _label_picture(shot: Shot, grasps: TableGrasps, rng: np.random.Generator) -> Picture:
    """The cloud with its labels, every pixel with depth as a point, seen from the camera."""
    points = apply(shot.T_table_camera, D455.deproject(shot.depth).astype(np.float64))
    pixel = np.flatnonzero(shot.depth.ravel() > 0)
    ids = shot.ids.ravel()[pixel]
    rows = np.flatnonzero(ids >= 0)[::6]
    kind = np.zeros(len(points), dtype=np.int64)
    settings = LabelSettings(unknown_objects=False)
    kind[rows] = label(points[rows], ids[rows].astype(np.int64), grasps, rng, settings).kind
    image = np.tile(np.array(BACKGROUND, dtype=np.uint8), (D455.height * D455.width, 1))
    image[pixel] = np.where((ids >= 0)[:, None], _BLUE, _GREY)
    image = image.reshape(D455.height, D455.width, 3)
    for which, colour, radius in ((CANDIDATE, _GREEN, 1), (REFERENCE, _RED, 2)):
        for p in pixel[kind == which]:
            cv2.circle(image, (int(p % D455.width), int(p // D455.width)), radius, colour, -1, cv2.LINE_AA)
    tcp = apply(inverse(shot.T_table_camera), grasps.position)
    for u, v in D455.project(tcp[tcp[:, 2] > 0.1]):
        cv2.circle(image, (round(float(u)), round(float(v))), 1, _PURPLE, -1, cv2.LINE_AA)
    return _fit(image)


def scene_sheet(data: GraspDataset, numbers: list[int], seed: int = 0) -> Picture:
    """Page of scenes, one row each."""
    tiles, captions = [], []
    for number in numbers:
        scene = data.scenes[number]
        rng = np.random.default_rng([seed, number])
        grasps = data.scene_grasps(scene)
        azimuth = float(rng.uniform(-np.pi, np.pi))
        rows = spread_out(grasps.position, rng)
        shot = _shoot(data, scene, rng, azimuth)
        tiles += [
            _table_picture(data, scene, grasps, rows, azimuth),
            _depth_picture(shot),
            _label_picture(shot, grasps, rng),
        ]
        graspable = len(np.unique(scene.instance))
        captions += [
            (
                f"scene {number}: {len(scene.objects)} objects",
                f"{len(rows)} of {len(scene.instance)} grasps on {graspable} objects",
            ),
            ("depth image with noise", "near = yellow, far = violet, black = no depth"),
            ("labels", "reference red, candidate green, TCP purple, table grey"),
        ]
    return contact_sheet(
        tiles, captions, 3, "Stage 2: scenes", "frame table, camera at 1 m, elevation 48 degrees"
    )

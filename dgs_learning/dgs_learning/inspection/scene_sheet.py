"""Contact sheets of scenes: the table with some of its grasps, the camera's depth image, and the labelled cloud."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import apply
from dgs_description.grasp import GraspSet
from dgs_learning.dataset import GraspDataset, SceneGrasps
from dgs_learning.inspection.grasp_sheet import HAND
from dgs_learning.inspection.sheet import contact_sheet
from dgs_learning.training.labels import CANDIDATE, REFERENCE, LabelSettings, label
from dgs_learning.training.views import TABLE_MESH, ViewSettings, camera_pose
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.pictures import (
    NO_POINTS,
    TABLE_COLOUR,
    DrawnHand,
    Item,
    Picture,
    View,
    draw,
    palette,
)
from dgs_sim_bridge.render.raster import render

Array = NDArray[np.float64]

ELEVATION = float(np.deg2rad(48.0))
VIEW = ViewSettings(distance=(1.0, 1.0), elevation=(ELEVATION, ELEVATION))
CLOSER = 1.45
"""The picture of the table shows it so many times larger than the camera's images."""
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


def _shoot(data: GraspDataset, scene: SceneGrasps, rng: np.random.Generator) -> Shot:
    T_table_camera = camera_pose(rng, VIEW)
    meshes = [(data.objects[k].vertices, data.objects[k].faces) for k in scene.objects]
    view = render(meshes, scene.T_table_object, D455, T_table_camera, table=TABLE_MESH)
    return Shot(VIEW.noise.apply(view.depth, D455, rng), view.ids, T_table_camera)


def spread_out(position: Array, rng: np.random.Generator, count: int = HANDS) -> list[int]:
    """Up to `count` of (G, 3) positions, drawn at random, at least `MIN_DISTANCE` apart."""
    chosen: list[int] = []
    for k in rng.permutation(len(position)):
        gaps = np.linalg.norm(position[chosen] - position[k], axis=1)
        if len(chosen) < count and (gaps > MIN_DISTANCE).all():
            chosen.append(int(k))
    return chosen


def _table_picture(data: GraspDataset, scene: SceneGrasps, grasps: GraspSet, T_table_view: Array) -> Picture:
    """Objects and hands, shaded, from the camera but closer."""
    focal = CLOSER * D455.fx
    camera = PinholeCamera(D455.width, D455.height, focal, focal, D455.cx, D455.cy)
    items = [Item(TABLE_MESH, np.eye(4), TABLE_COLOUR)]
    for k, T, colour in zip(scene.objects, scene.T_table_object, palette(len(scene.objects)), strict=True):
        items.append(Item((data.objects[k].vertices, data.objects[k].faces), T, colour))
    hands = [
        DrawnHand(grasp.pose, grasp.grasp_joints, HAND, grasp.active_fingers)
        for grasp in (grasps[k] for k in range(len(grasps)))
    ]
    return draw(NO_POINTS, NO_POINTS, hands, View(camera, T_table_view), items)


def _label_picture(shot: Shot, grasps: GraspSet, owner: NDArray, rng: np.random.Generator) -> Picture:
    """The cloud with its labels, every pixel with depth as a point, seen from the camera."""
    points = apply(shot.T_table_camera, D455.deproject(shot.depth).astype(np.float64))
    ids = shot.ids[shot.depth > 0].astype(np.int64)
    colours = np.where((ids >= 0)[:, None], _BLUE, _GREY)
    view = View(D455, shot.T_table_camera)
    cloud = draw(points, colours, [], view, point_size=3)
    rows = np.flatnonzero(ids >= 0)[::6]
    labels = label(points[rows], ids[rows], grasps, owner, rng, LabelSettings(unknown_objects=False))
    candidates, references = (points[rows[labels.kind == kind]] for kind in (CANDIDATE, REFERENCE))
    marks = [(candidates, _GREEN), (references, _RED), (grasps.position, _PURPLE)]
    places = np.concatenate([place for place, _ in marks])
    colours = np.concatenate([np.tile(colour, (len(place), 1)) for place, colour in marks])
    return draw(places, colours, [], view, point_size=9, background=cloud)


def scene_sheet(path: Path, data: GraspDataset, numbers: list[int], seed: int = 0) -> None:
    """Draw the page of scenes, one row each."""
    tiles: list[NDArray] = []
    captions = []
    for number in numbers:
        scene = data.scenes[number]
        rng = np.random.default_rng([seed, number])
        grasps = data.scene_grasps(scene)
        shot = _shoot(data, scene, rng)
        rows = spread_out(grasps.position, rng)
        tiles += [
            _table_picture(data, scene, grasps[rows], shot.T_table_camera),
            np.ma.masked_equal(-shot.depth, 0),
            _label_picture(shot, grasps, scene.instance, rng),
        ]
        graspable = len(np.unique(scene.instance))
        captions += [
            f"scene {number}: {len(scene.objects)} objects\n"
            f"{len(rows)} of {len(scene.instance)} grasps on {graspable} objects",
            "depth image with noise\nnear = yellow, far = violet, black = no depth",
            "labels\nreference red, candidate green, TCP purple, table grey",
        ]
    title = "Stage 2: scenes\nframe table, camera at 1 m, elevation 48 degrees"
    contact_sheet(path, tiles, captions, 3, 3.4, title)

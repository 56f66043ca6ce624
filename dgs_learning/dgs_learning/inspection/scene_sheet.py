"""Contact sheets of scenes: the table with some of its grasps, the camera's depth image, and the labelled cloud."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array, apply
from dgs_description.grasp import GraspSet, non_maximum_suppression
from dgs_learning.dataset import GraspDataset, SceneGrasps
from dgs_learning.inspection.grasp_sheet import HAND_COLOUR
from dgs_learning.inspection.sheet import contact_sheet
from dgs_learning.training.labels import CANDIDATE, REFERENCE, label
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

ELEVATION = float(np.deg2rad(48.0))
VIEW = ViewSettings(distance=(1.0, 1.0), elevation=(ELEVATION, ELEVATION))
CLOSER = 1.45
"""The picture of the table shows it so many times larger than the camera's images."""
HANDS = 4
MIN_DISTANCE = 0.11
"""Hands in one picture are at least so far apart [m]."""
_GREY, _BLUE, _RED = (190, 190, 192), (86, 130, 190), (214, 60, 52)
_GREEN, _PURPLE = (70, 165, 90), (140, 70, 170)
"""Table, objects, reference points, candidate points, TCPs: the colours of the paper's figure 4."""


def spread_out(position: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """Up to `HANDS` of (G, 3) positions, drawn at random, at least `MIN_DISTANCE` apart."""
    drawn = rng.permutation(len(position))
    return drawn[non_maximum_suppression(position[drawn], np.zeros(len(drawn)), MIN_DISTANCE, HANDS)]


def _table_picture(data: GraspDataset, scene: SceneGrasps, grasps: GraspSet, T_table_view: Array) -> Picture:
    """Objects and hands, shaded, from the camera but closer."""
    camera = replace(D455, fx=CLOSER * D455.fx, fy=CLOSER * D455.fx)
    items = [Item(TABLE_MESH, np.eye(4), TABLE_COLOUR)]
    for k, T, colour in zip(scene.objects, scene.T_table_object, palette(len(scene.objects)), strict=True):
        items.append(Item(data.objects[k].mesh, T, colour))
    shown = zip(grasps.pose, grasps.grasp_joints, grasps.active_fingers, strict=True)
    hands = [DrawnHand(pose, joints, HAND_COLOUR, active) for pose, joints, active in shown]
    return draw(NO_POINTS, NO_POINTS, hands, View(camera, T_table_view), items)


def _label_picture(
    points: Array,
    ids: NDArray[np.int64],
    grasps: GraspSet,
    owner: NDArray,
    view: View,
    rng: np.random.Generator,
) -> Picture:
    """The cloud (N, 3) with its labels, every pixel with depth as a point of an object (N,) or the table (-1)."""
    cloud = draw(points, np.where((ids >= 0)[:, None], _BLUE, _GREY), [], view, point_size=3)
    rows = np.flatnonzero(ids >= 0)[::6]
    labels = label(points[rows], ids[rows], grasps, owner, rng)
    candidates, references = (points[rows[labels.kind == kind]] for kind in (CANDIDATE, REFERENCE))
    marks = [(candidates, _GREEN), (references, _RED), (grasps.position, _PURPLE)]
    places = np.concatenate([place for place, _ in marks])
    colours = np.concatenate([np.tile(colour, (len(place), 1)) for place, colour in marks])
    return draw(places, colours, [], view, point_size=9, background=cloud)


def _row(data: GraspDataset, number: int, seed: int) -> tuple[list[NDArray], list[str]]:
    """Three tiles of one scene and their captions."""
    scene = data.scenes[number]
    rng = np.random.default_rng([seed, number])
    grasps, T_table_camera = data.scene_grasps(scene), camera_pose(rng, VIEW)
    meshes = [data.objects[k].mesh for k in scene.objects]
    image = render(meshes, scene.T_table_object, D455, T_table_camera, table=TABLE_MESH)
    depth = VIEW.noise.apply(image.depth, D455, rng)
    points = apply(T_table_camera, D455.deproject(depth).astype(np.float64))
    ids = image.ids[depth > 0].astype(np.int64)
    shown = spread_out(grasps.position, rng)
    tiles: list[NDArray] = [
        _table_picture(data, scene, grasps[shown], T_table_camera),
        np.ma.masked_equal(-depth, 0),
        _label_picture(points, ids, grasps, scene.instance, View(D455, T_table_camera), rng),
    ]
    graspable = len(np.unique(scene.instance))
    return tiles, [
        f"scene {number}: {len(scene.objects)} objects\n"
        f"{len(shown)} of {len(scene.instance)} grasps on {graspable} objects",
        "depth image with noise\nnear = yellow, far = violet, black = no depth",
        "labels\nreference red, candidate green, TCP purple, table grey",
    ]


def scene_sheet(path: Path, data: GraspDataset, numbers: list[int], seed: int = 0) -> None:
    """Draw the page of scenes, one row each."""
    rows = [_row(data, number, seed) for number in numbers]
    tiles = [tile for row, _ in rows for tile in row]
    captions = [caption for _, row in rows for caption in row]
    title = "Stage 2: scenes\nframe table, camera at 1 m, elevation 48 degrees"
    contact_sheet(path, tiles, captions, 3, 3.4, title)

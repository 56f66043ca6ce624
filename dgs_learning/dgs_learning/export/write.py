"""Writes scenes of a dataset to disk: images, clouds, masks and labels of every viewpoint."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array, apply, inverse
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.preprocess import LOWEST, prepare_rows
from dgs_learning.dataset import GraspDataset
from dgs_learning.export import layout
from dgs_learning.export.viewpoints import viewpoints, visible_shares
from dgs_learning.made_from import mark_folder
from dgs_learning.objects.catalogue import name_and_scale
from dgs_learning.parallel import Engine
from dgs_learning.training.labels import Labels, label
from dgs_learning.training.views import TABLE_MESH, ViewSettings
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.pictures import palette, shade
from dgs_sim_bridge.render.raster import TABLE, Rendering, render

GRASPS_PER_POINT = 10_000
"""No grasp is left out of the labels."""


@dataclass(frozen=True)
class ExportSettings:
    """Viewpoints per scene, seed of depth noise and drawn points, most points of a cloud, noise of the camera."""

    views: int = 256
    seed: int = 0
    points: int = 20_000
    noise: D455Noise = D455Noise()


def write_scene(data: GraspDataset, number: int, folder: Path, settings: ExportSettings) -> Path:
    """Write scene `number` to `folder`; it appears when it is complete."""
    target = folder / f"scene_{number:04d}"
    partial = folder / f"scene_{number:04d}.partial"
    shutil.rmtree(partial, ignore_errors=True)
    for name in layout.FOLDERS:
        (partial / name).mkdir(parents=True)
    scene = data.scenes[number]
    models = [data.objects[k] for k in scene.objects]
    meshes = [model.mesh for model in models]
    grasps = data.scene_grasps(scene)
    poses = viewpoints(settings.views, turn=number * 0.7)
    layout.write_camera(partial, D455)
    layout.write_extrinsics(partial, poses)
    layout.write_objects(partial, models, scene.T_table_object)
    labels = partial / "grasp_labels.txt"
    layout.write_grasps(labels, grasps, scene.instance, scene.grasp, scene.symmetry)
    shares = []
    for view, T_table_camera in enumerate(poses):
        image = render(meshes, scene.T_table_object, D455, T_table_camera, table=TABLE_MESH, normals=True)
        shares.append(visible_shares(image.ids, models, scene.T_table_object, D455, T_table_camera))
        rng = np.random.default_rng([settings.seed, number, view])
        depth = settings.noise.apply(image.depth, D455, rng)
        _write_images(partial, view, image, depth)
        labelled = grasps, scene.instance
        _write_cloud(partial, view, image.ids, depth, T_table_camera, labelled, rng, settings.points)
    layout.write_visibility(partial, np.array(shares))
    shutil.rmtree(target, ignore_errors=True)
    partial.rename(target)
    return target


def _write_images(scene: Path, view: int, image: Rendering, depth: NDArray[np.float32]) -> None:
    colour = shade(image, palette(int(image.ids.max(initial=-1)) + 1))
    segments = np.where(image.ids >= 0, image.ids + layout.SEGN_FIRST_OBJECT, layout.SEGN_NOTHING)
    segments[image.ids == TABLE] = layout.SEGN_TABLE
    images = {
        "rgb": np.clip(np.rint(colour), 0, 255).astype(np.uint8)[..., ::-1],
        "depth": np.rint(depth / layout.DEPTH_UNIT).astype(np.uint16),
        "segn": segments.astype(np.uint8),
    }
    for folder, pixels in images.items():
        path = layout.view_file(scene, folder, view)
        if not cv2.imwrite(str(path), np.ascontiguousarray(pixels)):
            raise OSError(f"{path} cannot be written")


def _write_cloud(
    scene: Path,
    view: int,
    ids: NDArray[np.int16],
    depth: NDArray[np.float32],
    T_table_camera: Array,
    grasps: tuple[GraspSet, NDArray],
    rng: np.random.Generator,
    count: int,
) -> None:
    """Cloud of the workspace and its labels, in the camera's optical frame."""
    points = D455.deproject(depth)
    instance = np.where(ids >= 0, ids, -1).ravel()[depth.ravel() > 0]
    in_table = apply(T_table_camera, points.astype(np.float64))
    x, y, z = ViewSettings().crop
    inside = np.flatnonzero((np.abs(in_table[:, :2]) < (x, y)).all(1) & (in_table[:, 2] < z))
    drawn = prepare_rows(in_table[inside], rng, LOWEST, keep_table=True, max_points=count)
    rows = inside[drawn]
    ids_of_rows = instance[rows].astype(np.int64)
    labels = label(in_table[rows], ids_of_rows, *grasps, rng, paper=True, grasps_per_point=GRASPS_PER_POINT)
    cloud = {
        "points": points[rows],
        "instance": ids_of_rows.astype(np.int16),
        "label": labels.kind.astype(np.uint8),
    }
    labelled = _view_grasps(labels, points[rows], T_table_camera)
    for name, arrays in (("pointcloud", cloud), ("grasp", labelled)):
        np.savez_compressed(layout.view_file(scene, name, view), allow_pickle=False, **arrays)


def _view_grasps(labels: Labels, points: NDArray[np.float32], T_table_camera: Array) -> dict[str, NDArray]:
    """The grasps that a view labels: reference point, offset, pose and joints, in the camera's optical frame."""
    turn = inverse(T_table_camera)[:3, :3].astype(np.float32)
    offset = labels.offset @ turn.T
    reference = points[labels.voxel]
    return {
        "grasp": labels.grasp.astype(np.int32),
        "point": labels.voxel.astype(np.int32),
        "offset": offset,
        "position": reference + offset,
        "rotation": turn @ labels.rotation,
        "j_init": HAND.expand(labels.j_init.astype(np.float64)).astype(np.float32),
        "j_end": HAND.expand(labels.j_end.astype(np.float64)).astype(np.float32),
    }


def export_scenes(
    data: GraspDataset, numbers: Sequence[int], folder: Path, settings: ExportSettings, engine: Engine
) -> Iterator[Path]:
    """Write scenes in parallel; those that are there already stay. Yields each folder when it is complete.

    Raises:
        DgsError: REQUEST_INVALID: the folder holds an export of another dataset or with other settings.
    """
    wishes = {name: getattr(settings, name) for name in ("views", "seed", "points")}
    described = {"layout_version": layout.VERSION, **wishes, "grasps": _digest(data)}
    mark_folder(folder, described, "export.json")
    todo = [n for n in numbers if not (folder / f"scene_{n:04d}").exists()]
    yield from engine.run(write_scene, ((data, n, folder, settings) for n in todo))


def _digest(data: GraspDataset) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(data.grasps.position).tobytes())
    for scene in data.scenes:
        digest.update(scene.T_table_object.tobytes() + scene.grasp.tobytes())
    return digest.hexdigest()[:16]


def export_stage_one(data: GraspDataset, folder: Path) -> int:
    """Stage-1 grasps as `CLASS/OBJECT/SCALE.txt`, in each object's frame; returns the number of files."""
    for k, model in enumerate(data.objects):
        grasps = data.own(k)
        name, scale = name_and_scale(model.name)
        path = folder / model.shape_class / layout.word(name) / f"{scale:.2f}.txt"
        path.parent.mkdir(parents=True, exist_ok=True)
        zero = np.zeros(len(grasps), dtype=np.int64)
        layout.write_grasps(path, grasps, zero, np.arange(len(grasps)), zero)
    return len(data.objects)

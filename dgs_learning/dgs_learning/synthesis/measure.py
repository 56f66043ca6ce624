"""What the generation costs: grasps per second, time per trial and stage and per training view, error of its depth."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray
from pybullet_utils.bullet_client import BulletClient

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, apply, inverse
from dgs_description.stage_clock import StageClock
from dgs_grasp_planner.preprocess import CloudSettings
from dgs_learning.dataset import GraspDataset
from dgs_learning.export.viewpoints import viewpoints
from dgs_learning.synthesis.generate import work_list
from dgs_learning.synthesis.sdf import signed_distance
from dgs_learning.synthesis.stage_one import DRAWS, MAX_RESTING_POSES, resting_ups, synthesise_chunk
from dgs_learning.training.views import TABLE_MESH, ViewSource
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES, ObjectModel
from dgs_sim_bridge.render.raster import Mesh, render

NEAR, FAR = 0.1, 3.0
"""Clipping planes of PyBullet's camera [m]."""


def measure_grasps(per_class: int, trials: int) -> dict[str, Any]:
    """Stage 1 on the first objects of every class, one chunk per resting pose, on this core.

    Args:
        per_class: objects of every class.
        trials: simulated candidates per chunk, at most.
    """
    clock = StageClock(time.process_time)
    rows, by_class, items = [], {}, work_list(0, 1)
    for shape_class in SHAPE_CLASSES:
        mine = [item for item in items if item[0].shape_class == shape_class][:per_class]
        own = [_measure_object(model, key, trials, clock) for model, key in mine]
        summed = _total(own)
        by_class[shape_class] = {key: summed[key] for key in ("grasps", "grasps_per_core_second")}
        rows += own
    total = _total(rows)
    each = 1e3 / max(1, total["trials"])
    physics = clock.times.get("closing", 0.0) + clock.times.get("gravity", 0.0)
    return {
        **total,
        "share_of_trials_kept": round(total["grasps"] / max(1, total["trials"]), 3),
        "physics_ms_per_trial": round(each * physics, 1),
        "stage_ms_per_trial": {stage: round(each * seconds, 2) for stage, seconds in clock.times.items()},
        "by_class": by_class,
        "objects": rows,
    }


def _total(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    total = {key: sum(row[key] for row in rows) for key in ("drawn", "trials", "grasps", "cpu_seconds")}
    rate = round(total["grasps"] / total["cpu_seconds"], 3)
    return {**total, "cpu_seconds": round(total["cpu_seconds"], 2), "grasps_per_core_second": rate}


def _measure_object(model: ObjectModel, key: list[int], trials: int, clock: StageClock) -> dict[str, Any]:
    started = time.process_time()
    with clock("distance grid"):
        sdf = signed_distance(model)
    with clock("resting poses"):
        ups = resting_ups(model, key[0])[:MAX_RESTING_POSES]
    draws = DRAWS.get(model.shape_class, DRAWS["other"])
    chunks = [
        synthesise_chunk(model, sdf, up[None], [*key, k], draws, trials, clock=clock)
        for k, up in enumerate(ups)
    ]
    return {
        "name": model.name,
        "shape_class": model.shape_class,
        "drawn": sum(c.drawn for c in chunks),
        "trials": sum(c.trials for c in chunks),
        "grasps": sum(len(c.grasps) for c in chunks),
        "cpu_seconds": round(time.process_time() - started, 3),
    }


def measure_views(data: GraspDataset, count: int) -> dict[str, Any]:
    """Processor time of fresh training views, with the table (20 000 points) and with it left out far from objects."""
    result = {}
    for name, cloud in (("with_table", CloudSettings(keep_table=True)), ("near_objects", CloudSettings())):
        source = ViewSource(data, seed=1, cloud=cloud)
        source.view(0, 10_000)  # warm-up
        times, points = [], []
        for k in range(count):
            started = time.process_time()
            view = source.view(k % len(data.scenes), k)
            times.append(1e3 * (time.process_time() - started))
            points.append(len(view.points))
        result[name] = {
            "views": count,
            "points": float(np.mean(points)),
            "median_ms": round(float(np.median(times)), 1),
            "p90_ms": round(float(np.percentile(times, 90)), 1),
        }
    return result


def compare_depth(data: GraspDataset, count: int) -> dict[str, Any]:
    """Rendered depth against PyBullet's own camera on scenes of the dataset, noise off."""
    errors, mismatched, pixels = [np.zeros(0)], 0, 0
    for k in range(count):
        scene = data.scenes[k % len(data.scenes)]
        models = [data.objects[o] for o in scene.objects]
        meshes = [(m.vertices, m.faces) for m in models]
        T_table_camera = viewpoints(count)[k]
        ours = render(meshes, scene.T_table_object, D455, T_table_camera, table=TABLE_MESH).depth
        poses = [*scene.T_table_object, np.eye(4)]
        theirs = pybullet_depth([*meshes, TABLE_MESH], poses, D455, T_table_camera)
        both, either = (ours > 0) & (theirs > 0), (ours > 0) | (theirs > 0)
        errors.append(np.abs(ours - theirs)[both])
        mismatched += int((either & ~both).sum())
        pixels += int(either.sum())
    error = np.concatenate(errors)
    return {
        "images": count,
        "pixels": pixels,
        "share_within_1_mm": round(float((error < 1e-3).sum() / max(1, pixels)), 6),
        "median_mm": round(1e3 * float(np.median(error)), 4),
        "p99_mm": round(1e3 * float(np.percentile(error, 99)), 4),
        "pixels_seen_by_one_only": mismatched,
    }


def pybullet_depth(
    meshes: Sequence[Mesh], poses: Sequence[Array], camera: PinholeCamera, T_world_camera: Array
) -> NDArray[np.float64]:
    """(H, W) depth [m] of PyBullet's software renderer, 0 = nothing."""
    bullet = BulletClient(pybullet.DIRECT)  # ends with this function
    for (vertices, faces), T in zip(meshes, poses, strict=True):
        corners, indices = apply(T, np.asarray(vertices, float)).tolist(), np.ravel(faces).tolist()
        shape = bullet.createVisualShape(pybullet.GEOM_MESH, vertices=corners, indices=indices)
        bullet.createMultiBody(0, baseVisualShapeIndex=shape)
    w, h = camera.width, camera.height
    # PyBullet samples a pixel at its left lower corner: column u at x = 2 u / w - 1, row v at y = 1 - 2 (v+1) / h.
    left, bottom = -camera.cx / camera.fx, (camera.cy + 1 - h) / camera.fy
    sides = left, left + w / camera.fx, bottom, bottom + h / camera.fy
    projection = pybullet.computeProjectionMatrix(*(NEAR * side for side in sides), NEAR, FAR)
    view = inverse(T_world_camera @ np.diag([1.0, -1.0, -1.0, 1.0])).T.ravel().tolist()
    flags = pybullet.ER_NO_SEGMENTATION_MASK
    image = bullet.getCameraImage(w, h, view, projection, renderer=pybullet.ER_TINY_RENDERER, flags=flags)
    buffer = np.asarray(image[3], dtype=np.float64).reshape(h, w)
    depth = FAR * NEAR / (FAR - (FAR - NEAR) * buffer)
    return np.where(depth < 0.999 * FAR, depth, 0.0)

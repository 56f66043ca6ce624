"""Where the camera stands for an exported scene, and how much of every object it sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, apply, inverse, look_at
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import render

RADIUS = 1.0
LOW, HIGH = np.deg2rad(22.5), np.deg2rad(67.5)
"""Distance [m] and elevation [rad] of the paper's viewpoints (section V-B)."""


def viewpoints(count: int, turn: float = 0.0) -> list[Array]:
    """`count` camera poses T_table_camera spread evenly over the paper's band of the hemisphere (golden-angle spiral).

    `turn` is the azimuth of the first one [rad].
    """
    height = np.sin(LOW) + (np.arange(count) + 0.5) / count * (np.sin(HIGH) - np.sin(LOW))
    azimuth = turn + np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - height**2)
    eyes = RADIUS * np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], -1)
    return [look_at(eye, (0, 0, 0)) for eye in eyes]


def visible_shares(
    ids: NDArray, models: Sequence[ObjectModel], poses: Array, camera: PinholeCamera, T_table_camera: Array
) -> Array:
    """(N,) share of every object's silhouette that is seen; 0 where it is hidden or outside the image.

    Args:
        ids: (H, W) rendered instances, without noise.
        poses: (N, 4, 4) T_table_object.
        T_table_camera: (4, 4).
    """
    shares = np.zeros(len(models))
    for k, (model, T) in enumerate(zip(models, poses, strict=True)):
        seen = int((ids == k).sum())
        if seen:
            shares[k] = seen / _silhouette(model, T, camera, T_table_camera)
    return shares


def _silhouette(
    model: ObjectModel, T_table_object: Array, camera: PinholeCamera, T_table_camera: Array
) -> int:
    """Pixels that the object alone would cover, those beyond the image's border included."""
    corners = apply(inverse(T_table_camera) @ T_table_object, model.vertices.astype(np.float64))
    pixels = camera.project(corners)
    low, high = np.floor(pixels.min(0)), np.ceil(pixels.max(0))
    width, height = ((high - low).astype(int) + 1).tolist()
    window = replace(camera, width=width, height=height, cx=camera.cx - low[0], cy=camera.cy - low[1])
    view = render([model.mesh], [T_table_object], window, T_table_camera)
    return max(1, int((view.ids == 0).sum()))

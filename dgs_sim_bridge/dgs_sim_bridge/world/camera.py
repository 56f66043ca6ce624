"""Depth, infrared and colour pictures of a world's snapshot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import CELL
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.pictures import shade
from dgs_sim_bridge.render.raster import box_mesh
from dgs_sim_bridge.render.shot import Stage, take_shot
from dgs_sim_bridge.world.world import Snapshot


@dataclass(frozen=True)
class Picture:
    """One shot.

    Attributes:
        depth: (H, W) float32, z in the optical frame [m], 0 = no depth.
        colour: (H, W, 3) uint8 red, green, blue; from the depth imager's place, so pixels match the depth.
        ids: (H, W) int16 instance per pixel (position in the snapshot), negative = floor or nothing.
        time: simulated time [s].
        left, right: (H, W) uint8 infrared images; None = not asked for.
    """

    depth: NDArray[np.float32]
    colour: NDArray[np.uint8]
    ids: NDArray[np.int16]
    time: float
    left: NDArray[np.uint8] | None = None
    right: NDArray[np.uint8] | None = None


def shoot(
    snapshot: Snapshot,
    camera: PinholeCamera = D455,
    noise: D455Noise | None = None,
    rng: np.random.Generator | None = None,
    imagers: int = 0,
) -> Picture:
    """Take a picture from the cell's nominal camera pose.

    Args:
        snapshot: `World.snapshot()`.
        camera: pinhole parameters.
        noise: errors of the depth camera; None = ideal depth.
        rng: for the noise; None = seed 0.
        imagers: infrared images: 0, 1 (left) or 2.
    """
    T_base_camera = CELL.T_base_camera_optical
    ground = box_mesh((-3.0, -3.0, CELL.floor_height - 0.1), (3.0, 3.0, CELL.floor_height))
    stage = Stage(snapshot.meshes, snapshot.poses, snapshot.materials, ground)
    rng = np.random.default_rng(0) if rng is None else rng
    shot = take_shot(stage, camera, T_base_camera, noise, rng, imagers=imagers, normals=True)
    colour = shade(shot.truth, snapshot.colours).astype(np.uint8)
    return Picture(shot.depth, colour, shot.truth.ids, snapshot.time, shot.left, shot.right)

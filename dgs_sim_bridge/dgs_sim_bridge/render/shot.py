"""What the D455 delivers of a scene: depth as the camera reports it and, where wanted, its two infrared images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, transform
from dgs_sim_bridge.render.d455 import D455Noise, Image
from dgs_sim_bridge.render.glass import reported_depth
from dgs_sim_bridge.render.infrared import (
    PROJECTOR_PLACE,
    Light,
    Picture,
    expose,
    infrared_image,
    with_glass,
)
from dgs_sim_bridge.render.object_model import GLASS, MIRROR, OPAQUE
from dgs_sim_bridge.render.raster import Mesh, Rendering, render


@dataclass(frozen=True)
class Stage:
    """What stands in front of the camera.

    Attributes:
        meshes: vertices and faces per mesh.
        poses: (N, 4, 4) T_world_mesh.
        materials: of every mesh, one of `MATERIALS`; empty = all opaque.
        table: a mesh in the world frame.
    """

    meshes: Sequence[Mesh]
    poses: Sequence[NDArray] | NDArray
    materials: Sequence[str] = ()
    table: Mesh | None = None

    def made_of(self, material: str) -> NDArray[np.bool_]:
        """(N,) which meshes are."""
        materials = self.materials or [OPAQUE] * len(self.meshes)
        return np.array([m == material for m in materials], dtype=bool)

    def seen(
        self, camera: PinholeCamera, T_world_camera: Array, opaque: bool = False, normals: bool = True
    ) -> Rendering:
        """Rendering of everything, or of what is opaque; ids are positions among all meshes."""
        keep = [k for k, is_opaque in enumerate(self.made_of(OPAQUE)) if is_opaque or not opaque]
        meshes, poses = [self.meshes[k] for k in keep], [self.poses[k] for k in keep]
        view = render(meshes, poses, camera, T_world_camera, table=self.table, normals=normals)
        if len(keep) == len(self.meshes):
            return view
        # Negative ids (table, nothing) count from the end.
        return Rendering(view.depth, np.array([*keep, -2, -1], np.int16)[view.ids], view.normals)


@dataclass(frozen=True)
class Shot:
    """One shot of the depth camera.

    Attributes:
        depth: (H, W) float32 as the camera reports it [m], 0 = none; its place is the left imager's.
        truth: what an ideal camera sees, glass as if it were opaque.
        left, right: (H, W) uint8 rectified infrared images; None = not wanted.
    """

    depth: Image
    truth: Rendering
    left: Picture | None = None
    right: Picture | None = None


def take_shot(
    stage: Stage,
    camera: PinholeCamera,
    T_world_camera: Array,
    noise: D455Noise | None,
    rng: np.random.Generator,
    *,
    imagers: int = 0,
    normals: bool = False,
) -> Shot:
    """Take one.

    Args:
        camera: of both imagers and of the depth image.
        T_world_camera: (4, 4) pose of the left imager's optical frame.
        noise: errors of the depth; None = those of glass only.
        rng: source of all randomness. It draws the same for the depth whether or not there are infrared images.
        imagers: how many infrared images: 0, 1 (left) or 2.
    """
    clear = not stage.made_of(OPAQUE).all()
    front = stage.seen(camera, T_world_camera, normals=normals or imagers > 0)
    behind = stage.seen(camera, T_world_camera, opaque=True) if clear else front
    depth = front.depth
    if clear:
        depth = reported_depth(front, behind, stage.made_of(GLASS), stage.made_of(MIRROR), rng)
    if noise is not None:
        depth = noise.apply(depth, camera, rng)
    if not imagers:
        return Shot(depth, front)
    own = rng.spawn(1)[0]
    light = Light(int(own.integers(2**31)))
    pictures = [_imager(stage, camera, T_world_camera, T_world_camera, light, own, (front, behind))]
    if imagers == 2:
        T_right = T_world_camera @ transform(position=(D455Noise.baseline, 0.0, 0.0))
        pictures.append(_imager(stage, camera, T_right, T_world_camera, light, own))
    return Shot(depth, front, *pictures)


def _imager(
    stage: Stage,
    camera: PinholeCamera,
    T_world_imager: Array,
    T_world_left: Array,
    light: Light,
    rng: np.random.Generator,
    views: tuple[Rendering, Rendering] | None = None,
) -> Picture:
    """The image of one imager; `views`: of everything and of what is opaque, where they are known."""
    front = views[0] if views else stage.seen(camera, T_world_imager)
    behind = views[1] if views else stage.seen(camera, T_world_imager, opaque=True)
    T_projector = T_world_left @ transform(position=(PROJECTOR_PLACE * D455Noise.baseline, 0.0, 0.0))
    lit = stage.seen(camera, T_projector, opaque=True, normals=False).depth
    poses = np.asarray(stage.poses, float).reshape(-1, 4, 4)
    image = infrared_image(behind, poses, camera, T_world_imager, T_projector, lit, light)
    glass, mirror = stage.made_of(GLASS), stage.made_of(MIRROR)
    if glass.any() or mirror.any():
        image = with_glass(image, front, glass, mirror, camera, T_world_imager, light)
    return expose(image, rng)

"""Turns rendered depth and normals into a picture: soft light, shade in corners, outlines, smooth edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_sim_bridge.render.raster import TABLE, Mesh, Rendering, render

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Colour = tuple[float, float, float]
"""Red, green, blue in 0..255."""

BACKGROUND: Colour = (247, 248, 250)
TABLE_COLOUR: Colour = (222, 219, 212)
_LIGHT = np.array([-0.45, -0.65, -0.62])
"""From the surface to the light in the optical frame (x right, y down, z forward)."""


@dataclass(frozen=True)
class Item:
    """Something to draw.

    Attributes:
        mesh: vertices and faces.
        T_world_mesh: (4, 4) pose.
        colour: red, green, blue in 0..255.
        glass: drawn see-through, behind and before opaque things.
    """

    mesh: Mesh
    T_world_mesh: Array
    colour: Colour
    glass: bool = False


def draw(
    items: Sequence[Item],
    camera: PinholeCamera,
    T_world_camera: Array,
    table: Mesh | None = None,
    opacity: float = 0.38,
    oversample: int = 2,
) -> Picture:
    """Picture (H, W, 3) uint8 of shaded meshes.

    Args:
        items: what is there.
        camera: image size and pinhole parameters.
        T_world_camera: (4, 4) pose of the optical frame.
        table: a mesh in the world frame, drawn in `TABLE_COLOUR`.
        opacity: of glass.
        oversample: drawn so many times larger and averaged.
    """
    large = replace(
        camera,
        width=camera.width * oversample,
        height=camera.height * oversample,
        fx=camera.fx * oversample,
        fy=camera.fy * oversample,
        cx=(camera.cx + 0.5) * oversample - 0.5,
        cy=(camera.cy + 0.5) * oversample - 0.5,
    )
    solid = [item for item in items if not item.glass]
    view = _render(solid, large, T_world_camera, table)
    image = shade(view, [item.colour for item in solid], large)
    glass = [item for item in items if item.glass]
    if glass:
        pane = _render(glass, large, T_world_camera, None)
        front = (pane.ids >= 0) & ((pane.depth < view.depth) | (view.depth == 0))
        tint = shade(pane, [item.colour for item in glass], large)
        image[front] = opacity * tint[front] + (1 - opacity) * image[front]
    small = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)


def _render(
    items: Sequence[Item], camera: PinholeCamera, T_world_camera: Array, table: Mesh | None
) -> Rendering:
    return render(
        [i.mesh for i in items],
        [i.T_world_mesh for i in items],
        camera,
        T_world_camera,
        table=table,
        normals=True,
    )


def shade(
    view: Rendering, colours: Sequence[Colour], camera: PinholeCamera, outline: bool = True
) -> NDArray[np.float32]:
    """(H, W, 3) float32 colours in 0..255.

    Args:
        view: rendered with normals.
        colours: one per mesh.
        camera: it was rendered with.
        outline: draw a dark line around every mesh, as in a drawing; a camera sees none.
    """
    assert view.normals is not None, "render with normals=True"
    palette = np.array([*colours, TABLE_COLOUR, BACKGROUND], dtype=np.float32)
    row = np.where(view.ids >= 0, view.ids, np.where(view.ids == TABLE, len(colours), len(colours) + 1))
    image = palette[row]
    hit = view.depth > 0
    light = _LIGHT / np.linalg.norm(_LIGHT)
    facing = view.normals[hit] @ light
    # Half Lambert keeps the form of sides that are turned from the light; a weak headlight lifts what faces the viewer.
    bright = 0.42 + 0.5 * (0.5 + 0.5 * facing) ** 1.6 + 0.16 * np.abs(view.normals[hit][:, 2])
    bright *= _openness(view.depth, camera)[hit]
    half = light + np.array([0.0, 0.0, -1.0])
    gleam = np.clip(view.normals[hit] @ (half / np.linalg.norm(half)), 0, 1) ** 40
    solid = view.ids[hit] != TABLE
    image[hit] = image[hit] * bright[:, None] + (38 * gleam * solid)[:, None]
    if outline:
        image[_outline(view)] *= 0.62
    return image


def _openness(depth: NDArray[np.float32], camera: PinholeCamera, radius: float = 0.02) -> NDArray[np.float32]:
    """(H, W) 1 where nothing stands close in front, less in corners and under things (screen-space occlusion).

    Every pixel is compared with the mean of two opposite neighbours, so that a slanted plane throws no shade on itself.
    """
    seen = depth > 0
    if not seen.any():
        return np.ones_like(depth)
    filled = np.where(seen, depth, depth.max())
    reach = camera.fx * radius / float(np.median(depth[seen]))
    shadow = np.zeros_like(filled)
    for share in (0.3, 0.65, 1.0):
        for angle in np.pi * (np.arange(4) + share) / 4:
            step = round(share * reach * np.sin(angle)), round(share * reach * np.cos(angle))
            around = _shifted(filled, *step) + _shifted(filled, -step[0], -step[1])
            nearer = (filled - around / 2) / np.float32(radius)
            # What stands far in front does not touch the pixel, and throws no shade there.
            shadow += np.clip(2 * nearer, 0, 1) * np.clip(1.6 - nearer, 0, 1)
    return (1.0 - 0.75 * np.clip(shadow / 12, 0, 1)).astype(np.float32)


def _shifted(image: NDArray[np.float32], down: int, right: int) -> NDArray[np.float32]:
    """The image moved by whole pixels; the border is repeated."""
    height, width = image.shape
    rows = np.clip(np.arange(height) - down, 0, height - 1)
    columns = np.clip(np.arange(width) - right, 0, width - 1)
    return image[rows][:, columns]


def _outline(view: Rendering) -> NDArray[np.bool_]:
    """Pixels next to another mesh or to a step in depth."""
    edge = np.zeros(view.ids.shape, dtype=bool)
    for axis in (0, 1):
        step = (np.diff(view.ids, axis=axis) != 0) | (np.abs(np.diff(view.depth, axis=axis)) > 0.012)
        edge[tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))] |= step
    return edge & (view.ids >= 0)

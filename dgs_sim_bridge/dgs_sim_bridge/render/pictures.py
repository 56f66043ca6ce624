"""Draws meshes, point clouds and whole hands, seen from any side: every picture of the suite. No ROS."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.frames import Array, apply, inverse, look_at
from dgs_sim_bridge.render.meshes import hand_parts
from dgs_sim_bridge.render.raster import TABLE, Mesh, Rendering, render

Picture = NDArray[np.uint8]
Colour = tuple[float, float, float]
"""Red, green, blue in 0..255."""

NO_POINTS = np.empty((0, 3))
PALM_OPACITY = 0.45
"""Palms are drawn as glass: they would hide the objects."""

BACKGROUND: Colour = (250, 250, 252)
TABLE_COLOUR: Colour = (222, 219, 212)
IDLE: Colour = (176, 186, 198)
"""Of fingers that take no part in a grasp."""
_LIGHT = np.array([-0.35, -0.6, -0.72])
"""Direction from the surface to the light in the optical frame (x right, y down, z forward)."""


@dataclass(frozen=True)
class Item:
    """A mesh in the picture: its pose (4, 4) [m], its colour, and how opaque it is (1 = solid)."""

    mesh: Mesh
    T_base_mesh: Array
    colour: Colour
    opacity: float = 1.0


@dataclass(frozen=True)
class DrawnHand:
    """A hand in the picture.

    Attributes:
        T_base_tcp: (4, 4) pose of hand_tcp in the frame of the cloud [m].
        joints: (J,) [rad].
        colour: red, green, blue in 0..255.
        active: (F,) bool, the other fingers are drawn pale; None = all.
        opacity: of the fingers; the palm has `PALM_OPACITY` of it.
    """

    T_base_tcp: Array
    joints: Array
    colour: Colour
    active: NDArray[np.bool_] | None = None
    opacity: float = 1.0

    def items(self) -> list[Item]:
        """The pieces of the hand."""
        items = []
        for part in hand_parts(self.joints):
            idle = part.finger >= 0 and self.active is not None and not self.active[part.finger]
            opacity = self.opacity * (PALM_OPACITY if part.finger < 0 else 1.0)
            colour = IDLE if idle else self.colour
            items.append(Item(part.mesh, self.T_base_tcp @ part.T_tcp_part, colour, opacity))
        return items


@dataclass(frozen=True)
class View:
    """A virtual camera."""

    camera: PinholeCamera
    T_base_camera: Array

    @classmethod
    def oblique(cls) -> View:
        """From the front and one side onto the middle of the workspace, so that hands do not hide their objects."""
        centre = CELL.T_base_table[:3, 3] + np.array([0.0, 0.0, 0.06])
        direction = np.array([0.62, -0.55, 0.56])
        eye = centre + 1.12 * (direction / np.linalg.norm(direction))
        return cls(PinholeCamera.centred(1280, 720, 1.05 * 1280), look_at(eye, centre))


def palette(count: int) -> list[Colour]:
    """`count` colours that can be told apart, by golden-ratio steps of the hue."""
    rows = [colorsys.hsv_to_rgb((0.08 + 0.618034 * k) % 1.0, 0.52, 0.86) for k in range(count)]
    return [(255 * r, 255 * g, 255 * b) for r, g, b in rows]


def draw(
    points: NDArray,
    colours: NDArray,
    hands: Sequence[DrawnHand],
    view: View,
    items: Sequence[Item] = (),
    point_size: int = 5,
    background: Picture | None = None,
) -> Picture:
    """Picture of a cloud, hands and other meshes.

    Args:
        points: (N, 3) cloud [m].
        colours: (N, 3) uint8 red, green, blue.
        hands: drawn as shapes that hide, and are hidden by, the points.
        point_size: edge of a point's square in the doubled picture [px].
        background: (H, W, 3) uint8 behind everything; None = nearly white.

    Returns:
        (H, W, 3) uint8; drawn twice as large and averaged, so edges are smooth.
    """
    small = view.camera
    camera = PinholeCamera(
        2 * small.width, 2 * small.height, 2 * small.fx, 2 * small.fy, 2 * small.cx + 0.5, 2 * small.cy + 0.5
    )
    image = np.tile(np.array(BACKGROUND, dtype=np.float32), (camera.height, camera.width, 1))
    if background is not None:
        image = cv2.resize(background, (camera.width, camera.height)).astype(np.float32)
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    _splat(image, depth, points, colours, camera, view.T_base_camera, point_size)
    every = [*items, *(item for hand in hands for item in hand.items())]
    # Solid things first: what is seen through the others must be there already.
    for opacity in sorted({item.opacity for item in every}, reverse=True):
        _blend(image, depth, [i for i in every if i.opacity == opacity], camera, view.T_base_camera, opacity)
    return cv2.resize(image.astype(np.uint8), (small.width, small.height), interpolation=cv2.INTER_AREA)


def shade(view: Rendering, colours: Sequence[Colour]) -> NDArray[np.float32]:
    """(H, W, 3) colours in 0..255 of what was rendered with normals; meshes have `colours`, the table its own."""
    assert view.normals is not None, "render with normals=True"
    paint = np.array([*colours, BACKGROUND, TABLE_COLOUR], dtype=np.float32)
    other = np.where(view.ids == TABLE, len(paint) - 1, len(paint) - 2)
    image = paint[np.where(view.ids < 0, other, view.ids)]
    hit = view.depth > 0
    facing = view.normals[hit] @ (_LIGHT / np.linalg.norm(_LIGHT))
    # Half Lambert: sides turned from the light keep their shape.
    image[hit] *= (0.35 + 0.65 * (0.5 + 0.5 * facing) ** 1.5)[:, None]
    return image


def cloud_colours(points: NDArray, image: Picture, camera: PinholeCamera, T_base_camera: Array) -> Picture:
    """Colours (N, 3) uint8 of points (N, 3) [m] in a colour image; grey where the image does not see them."""
    u, v, seen = _pixels(apply(inverse(T_base_camera), np.asarray(points, float)), camera)
    colours = np.full((len(points), 3), 128, dtype=np.uint8)
    colours[seen] = image[v[seen], u[seen]]
    return colours


def caption(image: Picture, text: str) -> Picture:
    """The picture with a line of text on a band along its lower edge."""
    band = max(20, image.shape[0] // 22)
    out = image.copy()
    out[-band:] = (out[-band:] * 0.25).astype(np.uint8)
    scale = band / 34
    origin = (band // 3, image.shape[0] - band // 3)
    cv2.putText(out, text, origin, cv2.FONT_HERSHEY_SIMPLEX, scale, (245, 245, 245), 1, cv2.LINE_AA)
    return out


def _blend(
    image: NDArray[np.float32],
    depth: NDArray[np.float32],
    items: Sequence[Item],
    camera: PinholeCamera,
    T_base_camera: Array,
    opacity: float,
) -> None:
    """Draw meshes with outlines over what is farther away; only solid ones hide what comes later."""
    poses = [item.T_base_mesh for item in items]
    view = render([item.mesh for item in items], poses, camera, T_base_camera, normals=True)
    shaded = shade(view, [item.colour for item in items])
    shaded[_outline(view)] *= 0.6
    hit = (view.ids >= 0) & (view.depth < depth)
    image[hit] = opacity * shaded[hit] + (1 - opacity) * image[hit]
    if opacity == 1.0:
        depth[hit] = view.depth[hit]


def _outline(view: Rendering) -> NDArray[np.bool_]:
    """Pixels above or left of which another mesh begins, or whose depth makes a step."""
    edge = np.zeros(view.ids.shape, dtype=bool)
    for axis in (0, 1):
        step = (np.diff(view.ids, axis=axis) != 0) | (np.abs(np.diff(view.depth, axis=axis)) > 0.012)
        edge[tuple(slice(1, None) if a == axis else slice(None) for a in (0, 1))] |= step
    return edge


def _splat(
    image: NDArray[np.float32],
    depth: NDArray[np.float32],
    points: NDArray,
    colours: NDArray,
    camera: PinholeCamera,
    T_base_camera: Array,
    size: int,
) -> None:
    """Paint points as squares, far ones first."""
    local = apply(inverse(T_base_camera), np.asarray(points, float))
    order = np.argsort(-local[:, 2])
    local, paint = local[order], np.asarray(colours, np.float32)[order]
    u, v, seen = _pixels(local, camera, margin=size)
    u, v, z, paint = u[seen], v[seen], local[seen, 2], paint[seen]
    for dv in range(size):
        for du in range(size):
            row, column = v + dv - size // 2, u + du - size // 2
            nearer = z < depth[row, column]
            # Of points on the same pixel the last, that is the nearest, stays.
            image[row[nearer], column[nearer]] = paint[nearer]
            depth[row[nearer], column[nearer]] = z[nearer]


def _pixels(local: Array, camera: PinholeCamera, margin: int = 0) -> tuple[NDArray, NDArray, NDArray]:
    """Pixel columns and rows of points in the optical frame, and which of them lie in the image."""
    with np.errstate(invalid="ignore"):
        u, v = np.round(camera.project(np.where(local[:, 2:] > 1e-3, local, np.nan))).T
        seen = (u >= margin) & (u < camera.width - margin) & (v >= margin) & (v < camera.height - margin)
    return np.where(seen, u, 0).astype(int), np.where(seen, v, 0).astype(int), seen

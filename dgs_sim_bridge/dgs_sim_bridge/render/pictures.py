"""Draws a point cloud with whole hands in it, seen from any side: pictures of what the planner predicted. No ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.frames import CELL, inverse, look_at
from dgs_sim_bridge.render.meshes import HandPart, hand_parts
from dgs_sim_bridge.render.raster import render

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

PALM_OPACITY = 0.45
"""Palms are drawn as glass: they would hide the objects."""

_BACKGROUND = np.array([250.0, 250.0, 252.0])
_LIGHT = np.array([-0.35, -0.6, -0.72])
"""Direction from the surface to the light in the optical frame (x right, y down, z forward)."""
_PALETTE = np.array(
    [(38, 132, 189), (230, 120, 40), (88, 160, 80), (170, 90, 180), (200, 170, 30), (200, 70, 80)]
)


@dataclass(frozen=True)
class DrawnHand:
    """A hand in the picture.

    Attributes:
        T_base_tcp: (4, 4) pose of hand_tcp in the frame of the cloud [m].
        joints: (20,) [rad].
        colour: red, green, blue in 0..255.
    """

    T_base_tcp: Array
    joints: Array
    colour: tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """A virtual camera."""

    camera: PinholeCamera
    T_base_camera: Array

    @classmethod
    def oblique(
        cls,
        width: int = 1280,
        height: int = 720,
        direction: tuple[float, float, float] = (0.62, -0.55, 0.56),
        distance: float = 1.12,
    ) -> View:
        """From the front and one side onto the middle of the workspace, so that hands do not hide their objects."""
        centre = CELL.T_base_table[:3, 3] + np.array([0.0, 0.0, 0.06])
        unit = np.array(direction) / np.linalg.norm(direction)
        focal = 1.05 * width
        camera = PinholeCamera.centred(width, height, focal)
        return cls(camera, look_at(centre + distance * unit, centre))


def palette(count: int) -> list[tuple[float, float, float]]:
    """`count` colours that can be told apart, then the same ones again."""
    return [tuple(_PALETTE[k % len(_PALETTE)].tolist()) for k in range(count)]


def draw(
    points: NDArray,
    colours: NDArray,
    hands: Sequence[DrawnHand],
    view: View,
    point_size: int = 5,
    background: Picture | None = None,
) -> Picture:
    """Picture of a cloud and hands.

    Args:
        points: (N, 3) cloud [m].
        colours: (N, 3) uint8 red, green, blue.
        hands: drawn as solid shapes that hide, and are hidden by, the points.
        view: from where.
        point_size: edge of a point's square in the doubled picture [px].
        background: (H, W, 3) uint8 behind everything; None = nearly white.

    Returns:
        (H, W, 3) uint8; drawn twice as large and averaged, so edges are smooth.
    """
    small = view.camera
    camera = PinholeCamera(
        2 * small.width, 2 * small.height, 2 * small.fx, 2 * small.fy, 2 * small.cx + 0.5, 2 * small.cy + 0.5
    )
    image = np.tile(_BACKGROUND.astype(np.float32), (camera.height, camera.width, 1))
    if background is not None:
        image = cv2.resize(background, (camera.width, camera.height)).astype(np.float32)
    depth = np.full((camera.height, camera.width), np.inf, dtype=np.float32)
    _splat(image, depth, points, colours, camera, view.T_base_camera, point_size)
    pieces = [(part, hand) for hand in hands for part in hand_parts(hand.joints)]
    fingers = [(part, hand) for part, hand in pieces if part.finger >= 0]
    palms = [(part, hand) for part, hand in pieces if part.finger < 0]
    _blend(image, depth, fingers, camera, view.T_base_camera, opacity=1.0)
    _blend(image, depth, palms, camera, view.T_base_camera, opacity=PALM_OPACITY)
    return cv2.resize(image.astype(np.uint8), (small.width, small.height), interpolation=cv2.INTER_AREA)


def cloud_colours(points: NDArray, image: Picture, camera: PinholeCamera, T_base_camera: Array) -> Picture:
    """Colours (N, 3) uint8 of points (N, 3) [m] in a colour image; grey where the image does not see them."""
    local = np.asarray(points, float) @ inverse(T_base_camera)[:3, :3].T + inverse(T_base_camera)[:3, 3]
    u, v, seen = _pixels(local, camera)
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
    parts: Sequence[tuple[HandPart, DrawnHand]],
    camera: PinholeCamera,
    T_base_camera: Array,
    opacity: float,
) -> None:
    """Draw parts of hands, shaded, over what is farther away; only opaque parts hide what comes later."""
    if not parts:
        return
    poses = [hand.T_base_tcp @ part.T_tcp_part for part, hand in parts]
    view = render([part.mesh for part, _ in parts], poses, camera, T_base_camera, normals=True)
    assert view.normals is not None
    hit = (view.ids >= 0) & (view.depth < depth)
    facing = view.normals[hit] @ (_LIGHT / np.linalg.norm(_LIGHT))
    colours = np.array([hand.colour for _, hand in parts], dtype=np.float32)[view.ids[hit]]
    # Half Lambert: sides turned from the light keep their shape.
    shaded = colours * (0.35 + 0.65 * (0.5 + 0.5 * facing) ** 1.5)[:, None]
    image[hit] = opacity * shaded + (1 - opacity) * image[hit]
    if opacity == 1.0:
        depth[hit] = view.depth[hit]


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
    T_camera_base = inverse(T_base_camera)
    local = np.asarray(points, float) @ T_camera_base[:3, :3].T + T_camera_base[:3, 3]
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
    z = np.where(local[:, 2] > 1e-3, local[:, 2], np.nan)
    with np.errstate(invalid="ignore"):
        u, v = (
            np.round(local[:, 0] / z * camera.fx + camera.cx),
            np.round(local[:, 1] / z * camera.fy + camera.cy),
        )
        seen = (u >= margin) & (u < camera.width - margin) & (v >= margin) & (v < camera.height - margin)
    return np.where(seen, u, 0).astype(int), np.where(seen, v, 0).astype(int), seen

"""Depth of glass and mirrors from the raw depth image and the left infrared image, by a small network (U-Net).

The network works on half of the resolution, relative to the plane of the table: what it is told of a pixel, and
what it says, is r = z_plane / z - 1 (0 on the table, positive above it), which depends on neither tilt nor distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import expit

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.paths import models_dir
from dgs_description.unet import UNet
from dgs_perception.edges import on_surface

Image = NDArray[np.float32]

NAME = "depth_completion"
"""Of the weights in the models folder."""
WIDTHS = (16, 40, 72, 96, 96)
"""Channels per level; every level has half of the resolution of the one before."""
SCALE = 10.0
"""Of r, so that objects on a table are of the order of one."""
LIMIT = 0.5
"""Larger |r| is cut: it is no object on that plane."""
CLEAR = 0.3
"""Pixels that are glass or mirror with a larger probability are replaced."""
UNSURE = 0.03
"""Replaced pixels whose expected error of r is larger are left empty."""
_TRIALS, _TOLERANCE, _STEP = 100, 0.01, 6
_ENOUGH = 0.5
"""Share of the largest plane's pixels that a nearer plane must have to be taken for the table."""


@dataclass(frozen=True)
class NetworkInput:
    """What the network sees: half of the resolution.

    Attributes:
        features: (4, h, w) float32: r times `SCALE`, whether there is depth, infrared in 0..1, z of the plane [m] - 1.
        plane: (3,) a, b, c of the plane 1/z = a x + b y + c, with x, y = pixel ray at z = 1 [1/m].
    """

    features: Image
    plane: NDArray[np.float64]


def completion_net() -> UNet:
    """Inputs as in `NetworkInput`; outputs: logit of glass or mirror, r times `SCALE`, log of its expected error."""
    return UNet(4, 3, WIDTHS)


def half_rays(camera: PinholeCamera) -> tuple[Image, Image]:
    """x and y at z = 1 of every second column (w,) and row (h,), of which the network takes an even number."""
    x, y = (axis[: len(axis) // 4 * 4 : 2].astype(np.float32) for axis in camera.rays)
    return x, y


def network_input(depth: Image, infrared: NDArray[np.uint8], camera: PinholeCamera) -> NetworkInput:
    """What the network sees of depth (H, W) [m], 0 = none, and the left infrared image (H, W)."""
    x, y = half_rays(camera)
    rows, columns = len(y), len(x)
    half = depth[: 2 * rows : 2, : 2 * columns : 2]
    plane = table_plane(half, x, y)
    plane_depth = depth_of_plane(plane, x, y)
    bright = cv2.resize(infrared[: 2 * rows, : 2 * columns], (columns, rows), interpolation=cv2.INTER_AREA)
    features = [
        relative(half, plane_depth) * SCALE,
        half > 0,
        bright / np.float32(255.0),
        np.minimum(plane_depth, 3.0) - 1.0,
    ]
    return NetworkInput(np.stack(features).astype(np.float32), plane)


def relative(depth: Image, plane_depth: Image) -> Image:
    """r within +-`LIMIT`, 0 where there is no depth."""
    r = np.divide(plane_depth, depth, out=np.ones_like(depth), where=depth > 0) - 1.0
    return np.clip(r, -LIMIT, LIMIT)


def depth_of_plane(plane: NDArray, x: NDArray, y: NDArray) -> Image:
    """(h, w) z of a plane along the rays x (w,), y (h,) [m]; 100 m where it is beyond that."""
    inverse = plane[0] * x + plane[1] * y[:, None] + plane[2]
    return (1.0 / np.maximum(inverse, 0.01)).astype(np.float32)


def table_plane(depth: Image, x: Image, y: Image) -> NDArray[np.float64]:
    """(3,) the nearest of the large planes of a depth image (RANSAC in 1/z, always the same draws, then least squares).

    Where there is hardly any depth: a plane at 1 m.
    """
    rows, columns = np.nonzero(depth[::_STEP, ::_STEP] > 0)
    if len(rows) < 50:
        return np.array([0.0, 0.0, 1.0])
    rays = np.column_stack([x[::_STEP][columns], y[::_STEP][rows], np.ones(len(rows))])
    inverse = 1.0 / depth[::_STEP, ::_STEP][rows, columns]
    draws = np.random.default_rng(0).integers(len(rays), size=(_TRIALS, 3))
    corners = rays[draws]
    usable = np.abs(np.linalg.det(corners)) > 1e-4
    planes = np.linalg.solve(corners[usable], inverse[draws[usable]][..., None])[..., 0]
    if not len(planes):
        return np.array([0.0, 0.0, float(np.median(inverse))])
    error = np.abs(planes @ rays.T / inverse - 1.0)
    support = (error < _TOLERANCE).sum(1)
    # A floor may show more of itself than the table in front of it.
    nearest = np.where(support > support.max() * _ENOUGH, np.median(planes @ rays.T, axis=1), -np.inf)
    near = error[np.argmax(nearest)] < _TOLERANCE
    return np.linalg.lstsq(rays[near], inverse[near], rcond=None)[0]


class DepthCompletion:
    """The network with its weights."""

    def __init__(self, file: Path | None = None) -> None:
        """Load the weights; None = those in the models folder.

        Raises:
            DgsError: DEPTH_SOURCE: the file is missing or holds something else.
        """
        weights = file or models_dir() / f"{NAME}.pt"
        self.net = completion_net().loaded(weights, ErrorCode.DEPTH_SOURCE, "dgs train-completion")

    def __call__(
        self, depth: Image, infrared: NDArray[np.uint8], camera: PinholeCamera
    ) -> tuple[Image, Image]:
        """Complete a depth image.

        Args:
            depth: (H, W) [m], 0 = none.
            infrared: (H, W) left image.

        Returns:
            (H, W) depth [m], in which pixels of glass and mirrors are the network's or 0; (H, W) probability that a
            pixel is glass or mirror.

        Raises:
            DgsError: DEPTH_FORMAT: the images are not of the camera's size.
        """
        size = (camera.height, camera.width)
        if depth.shape != size or infrared.shape != size:
            came = f"depth of {depth.shape[::-1]} and infrared of {infrared.shape[::-1]} px"
            wrong = f"Depth completion got {came}; both must have the camera's {size[::-1]} px."
            raise DgsError(ErrorCode.DEPTH_FORMAT, wrong)
        seen = network_input(depth, infrared, camera)
        with torch.inference_mode():
            out = self.net(torch.from_numpy(seen.features)[None])[0].numpy()
        rows, columns = (2 * n for n in out.shape[1:])  # of which the network saw every second
        rest = (0, size[0] - rows, 0, size[1] - columns)
        logit, r, spread = (
            cv2.copyMakeBorder(cv2.resize(plane, (columns, rows)), *rest, cv2.BORDER_REPLICATE)
            for plane in out
        )
        x, y = (axis.astype(np.float32) for axis in camera.rays)
        found = depth_of_plane(seen.plane, x, y) / (1.0 + np.clip(r / SCALE, -LIMIT, LIMIT))
        found[np.exp(spread) > UNSURE * SCALE] = 0.0
        clear = expit(logit)
        completed = np.where(clear > CLEAR, found, depth)
        # What hangs between the network's outlines and what is behind is no rim of anything.
        completed[(clear > CLEAR) & ~on_surface(completed, camera)] = 0.0
        return completed, clear

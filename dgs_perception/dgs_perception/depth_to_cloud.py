"""Depth image and pinhole intrinsics to a point cloud in the camera's optical frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode

MILLIMETRE = 1e-3
"""Unit of 16-bit depth images as realsense-ros and REP-118 publish them [m]."""


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole model of a rectified depth image; a pixel (u, v) looks along ((u - cx) / fx, (v - cy) / fy, 1).

    Attributes:
        width, height: image size [px].
        fx, fy: focal lengths [px].
        cx, cy: principal point [px], the centre of pixel (0, 0) being (0, 0).

    Raises:
        DgsError: CAMERA_INFO_INVALID for an empty image, a focal length that is not positive, a principal point
            outside the image, or a number that is not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width <= 0 or self.height <= 0:
            raise _invalid(f"an image of {self.width} x {self.height} pixels")
        if not all(isfinite(value) for value in (self.fx, self.fy, self.cx, self.cy)):
            raise _invalid(f"fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}; all must be finite")
        if self.fx <= 0 or self.fy <= 0:
            raise _invalid(
                f"focal lengths fx {self.fx}, fy {self.fy}; both must be positive (is the camera calibrated?)"
            )
        if not (0 <= self.cx <= self.width and 0 <= self.cy <= self.height):
            raise _invalid(
                f"the principal point ({self.cx}, {self.cy}) outside its {self.width} x {self.height} image"
            )


def _invalid(what: str) -> DgsError:
    return DgsError(ErrorCode.CAMERA_INFO_INVALID, f"The camera info has {what}.")


@lru_cache(maxsize=8)
def ray_grid(intrinsics: Intrinsics) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Slopes x/z of every column (1, W) and y/z of every row (H, 1), float32, read-only."""
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    slopes = x.astype(np.float32)[None, :], y.astype(np.float32)[:, None]
    for array in slopes:
        array.setflags(write=False)
    return slopes


def depth_to_cloud(
    depth: NDArray[np.generic], intrinsics: Intrinsics, depth_unit: float = MILLIMETRE
) -> NDArray[np.float32]:
    """Points of all pixels, row by row, in the optical frame (x right, y down, z forward).

    Args:
        depth: (H, W) distance along the optical axis; uint16 in `depth_unit`, or floating point [m].
            Pixels without a measurement are 0 or NaN.
        intrinsics: of this image.
        depth_unit: size of one step of a uint16 image [m].

    Returns:
        (H * W, 3) float32 [m]; pixels without a measurement are (0, 0, 0) or NaN. The memory order is one plane per
        axis, which makes the steps that follow several times faster.

    Raises:
        DgsError: DEPTH_FORMAT for another type or dimension, CAMERA_INFO_INVALID when the sizes differ.
    """
    # issubdtype, because == would refuse the other byte order
    is_steps = np.issubdtype(depth.dtype, np.uint16)
    if depth.ndim != 2 or not (is_steps or np.issubdtype(depth.dtype, np.floating)):
        raise DgsError(
            ErrorCode.DEPTH_FORMAT,
            f"A depth image must be (height, width) of uint16 or floating point, not {depth.shape} of {depth.dtype}.",
        )
    height, width = depth.shape
    if (width, height) != (intrinsics.width, intrinsics.height):
        raise _invalid(
            f"{intrinsics.width} x {intrinsics.height} pixels but the depth image {width} x {height}"
        )
    x_slope, y_slope = ray_grid(intrinsics)
    planes = np.empty((3, height, width), np.float32)
    if is_steps:
        np.multiply(depth, np.float32(depth_unit), out=planes[2])
    else:
        planes[2] = depth
    # infinity times a slope of exactly 0 is NaN, which is dropped with the infinity anyway
    with np.errstate(invalid="ignore"):
        np.multiply(planes[2], x_slope, out=planes[0])
        np.multiply(planes[2], y_slope, out=planes[1])
    return planes.reshape(3, -1).T

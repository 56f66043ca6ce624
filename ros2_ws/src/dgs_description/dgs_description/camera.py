"""The pinhole camera: pixels to points and back, in its optical frame (x right, y down, z forward)."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array

MILLIMETRE = 1e-3
"""Unit of 16-bit depth images as realsense-ros and REP-118 publish them [m]."""


@dataclass(frozen=True)
class PinholeCamera:
    """A pixel (u, v) looks along ((u - cx) / fx, (v - cy) / fy, 1).

    Attributes:
        width, height: image size [px].
        fx, fy: focal lengths [px].
        cx, cy: principal point [px], the centre of pixel (0, 0) being (0, 0), as in librealsense and OpenCV.

    Raises:
        DgsError: CAMERA_INFO_INVALID for an empty image, a focal length that is not positive, or a number
            that is not finite.
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
            values = f"fx {self.fx}, fy {self.fy}, cx {self.cx}, cy {self.cy}"
            raise _invalid(f"the values {values}; all must be finite")
        if self.fx <= 0 or self.fy <= 0:
            need = "both must be positive (is the camera calibrated?)"
            raise _invalid(f"focal lengths fx {self.fx}, fy {self.fy}; {need}")

    @classmethod
    def centred(cls, width: int, height: int, focal: float) -> PinholeCamera:
        """Square pixels of focal length `focal` [px], principal point in the middle of the image."""
        return cls(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)

    @property
    def matrix(self) -> Array:
        """(3, 3) camera matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def rays(self) -> tuple[Array, Array]:
        """x (width,) and y (height,) of the columns and rows at z = 1."""
        x, y = np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64)
        return (x - self.cx) / self.fx, (y - self.cy) / self.fy

    def project(self, points: NDArray) -> Array:
        """(N, 2) pixel coordinates u, v of (N, 3) points with z > 0 [m]."""
        points = np.asarray(points, dtype=np.float64)
        scale, centre = np.array([self.fx, self.fy]), np.array([self.cx, self.cy])
        return points[:, :2] / points[:, 2:] * scale + centre

    def all_points(self, depth: NDArray, depth_unit: float = MILLIMETRE) -> NDArray[np.float32]:
        """Points of all pixels, row by row.

        Args:
            depth: (height, width) distance along the optical axis; uint16 in `depth_unit`, or floating point [m].
                Pixels without a measurement are 0 or NaN.
            depth_unit: size of one step of a uint16 image [m].

        Returns:
            (height * width, 3) float32 [m]; pixels without a measurement are (0, 0, 0) or NaN. The memory order is one
            plane per axis, which makes the steps that follow several times faster.

        Raises:
            DgsError: DEPTH_FORMAT for another type or dimension, CAMERA_INFO_INVALID when the sizes differ or the
                principal point lies outside the image.
        """
        # issubdtype, because == would refuse the other byte order
        is_steps = np.issubdtype(depth.dtype, np.uint16)
        if depth.ndim != 2 or not (is_steps or np.issubdtype(depth.dtype, np.floating)):
            must = "A depth image must be (height, width) of uint16 or floating point"
            raise DgsError(ErrorCode.DEPTH_FORMAT, f"{must}, not {depth.shape} of {depth.dtype}.")
        size = f"{self.width} x {self.height}"
        if depth.shape != (self.height, self.width):
            other = f"The camera has {size} pixels but the depth image {depth.shape[1]} x {depth.shape[0]}"
            other += ": take the intrinsics of the depth stream in this resolution."
            raise DgsError(ErrorCode.CAMERA_INFO_INVALID, other)
        if not (0 <= self.cx <= self.width and 0 <= self.cy <= self.height):
            raise _invalid(f"the principal point ({self.cx}, {self.cy}) outside its {size} image")
        x, y = self.rays
        planes = np.empty((3, *depth.shape), np.float32)
        planes[2] = depth * np.float32(depth_unit) if is_steps else depth
        # infinity times a slope of exactly 0 is NaN, which is dropped with the infinity anyway
        with np.errstate(invalid="ignore"):
            planes[0] = planes[2] * x
            planes[1] = planes[2] * y[:, None]
        return planes.reshape(3, -1).T

    def deproject(self, depth: NDArray) -> NDArray[np.float32]:
        """(N, 3) float32 points of the pixels that have depth, row by row; `depth` and errors as of `all_points`."""
        points = self.all_points(depth)
        measured = np.isfinite(points[:, 2]) & (points[:, 2] > 0)
        return np.ascontiguousarray(points[measured])


def _invalid(what: str) -> DgsError:
    return DgsError(ErrorCode.CAMERA_INFO_INVALID, f"A pinhole camera cannot have {what}.")

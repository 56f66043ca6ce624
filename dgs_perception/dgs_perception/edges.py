"""Takes flying pixels out of a depth image: depth between foreground and background, where no surface is.

A stereo camera's window straddles the edge of a thing and answers something between the two sides. In the cloud such
pixels hang behind edges like curtains. A pixel of a surface has neighbours that the surface explains; a flying one has
few. What the surface explains grows with the distance and with the angle under which it is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Half of a pixel's neighbours, rows and columns away; the other half lies opposite."""


@dataclass(frozen=True)
class EdgeFilter:
    """Which pixels stay.

    Attributes:
        steepest: a surface is seen under this angle of incidence at most [rad].
        neighbours: of the eight, so many must lie on the same surface.
    """

    steepest: float = float(np.deg2rad(70.0))
    neighbours: int = 3

    def kept(self, z: NDArray[np.float32], camera: PinholeCamera) -> NDArray[np.bool_]:
        """(H, W) which pixels of a depth image (H, W) [m] lie on a surface; 0 or NaN = no measurement."""
        reach = z * np.float32(np.tan(self.steepest) / camera.fx)
        count = np.zeros(z.shape, np.uint8)
        for step in _STEPS:
            here, there = _overlap(z.shape, step)
            with np.errstate(invalid="ignore"):
                near = np.abs(z[here] - z[there]) <= reach[here] * np.float32(np.hypot(*step))
            count[here] += near
            count[there] += near
        return np.asarray(count >= self.neighbours)

    def cleaned(self, z: NDArray[np.float32], camera: PinholeCamera) -> NDArray[np.float32]:
        """The depth image (H, W) [m] with 0 where `kept` says no."""
        return np.where(self.kept(z, camera), z, np.float32(0.0))

    def apply(self, points: NDArray[np.float32], camera: PinholeCamera) -> int:
        """Set the flying ones of `camera`'s points (H * W, 3) [m], as of `PinholeCamera.all_points`, to zero.

        Returns:
            their number.
        """
        z = points[:, 2]
        flying = ~self.kept(z.reshape(camera.height, camera.width), camera).ravel() & (z > 0)
        points[flying] = 0.0
        return int(flying.sum())


def _overlap(
    shape: tuple[int, int], step: tuple[int, int]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Windows of an image that lie a step apart."""
    (height, width), (down, right) = shape, step
    columns = slice(0, width - right) if right >= 0 else slice(-right, width)
    moved = slice(right, width) if right >= 0 else slice(0, width + right)
    return (slice(0, height - down), columns), (slice(down, height), moved)

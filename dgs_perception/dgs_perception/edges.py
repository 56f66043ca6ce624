"""Sets flying pixels of a depth image right: depth between foreground and background, where no surface is.

A stereo camera's window straddles the edge of a thing and answers something between the two sides. In the cloud such
pixels hang behind edges like curtains. A pixel of a surface has neighbours that the surface explains; a flying one has
few. What the surface explains grows with the distance and with the angle under which it is seen. The true edge is
where the window has as much of one side as of the other, so a flying pixel nearer to the foreground belongs to it.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Half of a pixel's neighbours, rows and columns away; the other half lies opposite."""
SHORTEST = 1e-3
"""What is nearer than this is no measurement [m]."""
FLAT = 0.06
"""What a plane leaves unexplained of a surface, as a share of the disparity's spread; of an edge it leaves more."""
STEEPER = 2.0
"""A surface changes its inverse depth from pixel to pixel so much more than most of the picture (the table) does."""
STEEPEST_GROUND = float(np.deg2rad(85.0))
"""So steep a surface is believed at most, however steep the picture is [rad]."""
ENOUGH = 0.25
"""Share of a window that must be measured to be told flat: a few pixels always lie on a plane."""
MOST_FLYING = 0.1
"""An image of which more flies is no picture of things; all of it goes, without the cost of a look around each."""
STEEPEST = float(np.deg2rad(70.0))
"""A surface is seen under this angle of incidence at most, unless a window shows nothing else [rad]."""
NEIGHBOURS = 3
"""Of the eight, so many must lie on the same surface."""
WINDOW = 13
"""Side of the square around a flying pixel in which both sides of the edge are seen [px]: about twice the camera's
matching window."""


def cleaned(z: NDArray[np.float32], camera: PinholeCamera) -> NDArray[np.float32]:
    """Depth without flying pixels.

    Args:
        z: (H, W) depth image [m]; 0 or NaN = no measurement.
        camera: its intrinsics.

    Returns:
        (H, W) the same, in which flying pixels have the depth of the foreground, or 0 where they are not of it.
        What lies on a plane that is all there is around it stays. Where more than `MOST_FLYING` flies, it goes.
    """
    surface, disparity = on_surface(z, camera), _disparity(z)
    v, u = np.nonzero(~surface & (disparity > 0))
    out = np.where(surface, z, np.float32(0.0))
    if len(v) > MOST_FLYING * z.size:
        return out
    out[v, u] = _foreground(disparity[v, u], _around(np.where(surface, disparity, 0), v, u))
    flat = _is_flat(_around(disparity, v, u))
    out[v[flat], u[flat]] = z[v[flat], u[flat]]
    return out


def on_surface(z: NDArray[np.float32], camera: PinholeCamera) -> NDArray[np.bool_]:
    """(H, W) which pixels of a depth image (H, W) [m] their neighbours explain; arguments of `cleaned`."""
    disparity = _disparity(z)
    slopes = np.tan([STEEPEST, STEEPEST_GROUND])
    count = np.zeros(disparity.shape, np.uint8)
    for step in _STEPS:
        here, there = _overlap(disparity.shape, step)
        change = np.abs(disparity[here] - disparity[there])
        sparse = change[::4, ::4][(disparity[here] > 0)[::4, ::4]]
        ground = np.median(sparse) if len(sparse) else 0.0
        usual, most = (disparity[here] * np.float32(k * np.hypot(*step) / camera.fx) for k in slopes)
        near = change <= np.maximum(usual, np.minimum(most, STEEPER * ground))
        count[here] += near
        count[there] += near
    return np.asarray((count >= NEIGHBOURS) & (disparity > 0))


def _around(image: NDArray[np.float32], v: NDArray, u: NDArray) -> NDArray[np.float32]:
    """(N, window^2) values of an image around N pixels, 0 beyond its border."""
    windows = sliding_window_view(np.pad(image, WINDOW // 2), (WINDOW, WINDOW))
    return windows[v, u].reshape(len(v), WINDOW**2)


def _is_flat(disparity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(N,) in which windows (N, window^2) one plane explains all that was measured, however steep it is.

    A plane's disparity is an affine function of the pixel.
    """
    steps = np.arange(WINDOW) - WINDOW // 2
    u, v = (g.ravel() for g in np.meshgrid(steps, steps))
    basis = np.stack([np.ones_like(u), u, v], axis=1).astype(np.float32)
    known = (disparity > 0).astype(np.float32)
    count = known.sum(axis=1)  # at least the one in the middle
    value = (disparity - (disparity.sum(axis=1) / count)[:, None]) * known
    products = (basis[:, :, None] * basis[:, None]).reshape(-1, 9)
    matrix = (known @ products).reshape(-1, 3, 3) + np.float32(1e-3) * np.eye(3, dtype=np.float32)
    affine = np.linalg.solve(matrix, (value @ basis)[:, :, None])[:, :, 0]
    left = (value - affine @ basis.T) * known
    flat = (left**2).sum(axis=1) < count * (FLAT * np.ptp(value, axis=1)) ** 2
    return np.asarray(flat & (count > ENOUGH * WINDOW**2))


def clean_points(points: NDArray[np.float32], camera: PinholeCamera) -> None:
    """Do to `camera`'s points (H * W, 3) [m], as of `PinholeCamera.all_points`, what `cleaned` does to depth."""
    z = points[:, 2]
    clean = cleaned(z.reshape(camera.height, camera.width), camera).ravel()
    flying = np.flatnonzero((clean != z) & (z > 0) & np.isfinite(z))
    points[flying] *= (clean[flying] / z[flying])[:, None]


def _disparity(z: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W) inverse depth [1/m], 0 where there is no measurement."""
    return np.divide(1.0, z, out=np.zeros_like(z), where=np.isfinite(z) & (z > SHORTEST))


def _overlap(
    shape: tuple[int, int], step: tuple[int, int]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Windows of an image that lie a step apart."""
    (height, width), (down, right) = shape, step
    columns = slice(0, width - right) if right >= 0 else slice(-right, width)
    moved = slice(right, width) if right >= 0 else slice(0, width + right)
    return (slice(0, height - down), columns), (slice(down, height), moved)


def _foreground(own: NDArray[np.float32], around: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N,) depth of the foreground at N flying pixels, 0 at those nearer to the background.

    Args:
        own: (N,) their inverse depths [1/m].
        around: (N, S^2) inverse depths of the surfaces in the window around each; 0 = none.
    """
    near = around.max(axis=1)
    far = np.where(around > 0, around, np.float32(np.inf)).min(axis=1)
    front = (around > 0) & (2 * around >= (near + far)[:, None])
    depth = front.sum(axis=1) / np.maximum(np.where(front, around, 0).sum(axis=1), np.float32(1e-6))
    # Where no background is seen, what was measured close to the foreground is of it.
    side = int(np.sqrt(around.shape[1]))
    close = slice(side // 2 - side // 4, side // 2 + side // 4 + 1)
    beside = (far > own) & (around.reshape(-1, side, side)[:, close, close] > 0).any(axis=(1, 2))
    of_front = ((2 * own >= near + far) | beside) & (own <= near)
    return np.where(of_front, depth, 0.0).astype(np.float32)

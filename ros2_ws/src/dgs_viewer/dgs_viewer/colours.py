"""A cloud as the page shows it: thinned, coloured by the camera's picture; and the colour of a score."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.cell import CELL
from dgs_description.cloud import finite_rows
from dgs_description.frames import Array, apply, inverse
from dgs_viewer.pointing import above_table
from dgs_viewer.state import Cloud

MOST_POINTS = 24_000
"""Of a cloud on the page; objects first."""
TABLE_SHARE = 0.4
"""So much of the points may be the table's."""
_LOW, _HIGH = np.array([70, 90, 140]), np.array([250, 220, 120])
"""Colours of the table's height and of 0.15 m above, where no picture says better."""
_SPAN = 0.15


def thinned(points: NDArray) -> NDArray:
    """At most `MOST_POINTS` of the finite points (N, 3) [m]: all of the objects if they fit, a share of the table."""
    points = points[finite_rows(points)]
    if len(points) <= MOST_POINTS:
        return points
    rng, high = np.random.default_rng(0), above_table(points)
    objects, table = np.flatnonzero(high), np.flatnonzero(~high)
    fewest = min(len(table), round(TABLE_SHARE * MOST_POINTS))
    objects = rng.permutation(objects)[: MOST_POINTS - fewest]
    table = rng.permutation(table)[: MOST_POINTS - len(objects)]
    return points[np.concatenate([objects, table])]


def by_height(points: Array) -> NDArray[np.uint8]:
    """(N, 3) colours of points (N, 3) in `base_link` by their height above the table."""
    share = np.clip((points[:, 2:] - CELL.table_height) / _SPAN, 0.0, 1.0)
    return (_LOW + share * (_HIGH - _LOW)).astype(np.uint8)


def from_picture(
    points: Array, picture: NDArray[np.uint8], camera: PinholeCamera, T_base_camera: Array
) -> NDArray[np.uint8]:
    """(N, 3) colours of points (N, 3) in `base_link` [m], looked up in a picture (H, W, 3); by height outside of it."""
    colours = by_height(points)
    local = apply(inverse(T_base_camera), np.asarray(points, np.float64))
    ahead = np.flatnonzero(local[:, 2] > 0.05)
    u, v = np.rint(camera.project(local[ahead])).astype(int).T
    inside = (u >= 0) & (u < picture.shape[1]) & (v >= 0) & (v < picture.shape[0])
    colours[ahead[inside]] = picture[v[inside], u[inside]]
    return colours


def make_cloud(
    points: NDArray,
    picture: NDArray[np.uint8] | None,
    camera: PinholeCamera | None,
    T_base_camera: Array | None,
) -> Cloud:
    """The cloud to show of (N, 3) points in `base_link` [m]; without a picture it is coloured by height."""
    shown = thinned(points)
    if picture is None or camera is None or T_base_camera is None:
        colours = by_height(shown)
    else:
        colours = from_picture(shown, picture, camera, T_base_camera)
    return Cloud(shown.astype(np.float16), colours)


def of_score(score: Array) -> NDArray[np.uint8]:
    """(K, 3) from red (0) over yellow to green (1), as in `/dgs/grasp_markers`."""
    share = np.clip(score, 0.0, 1.0)
    red, green = np.minimum(1.0, 2 - 2 * share), np.minimum(1.0, 2 * share)
    return (255 * np.stack([red, 0.9 * green, np.full_like(share, 0.15)], axis=-1)).astype(np.uint8)

"""Where a cloud shows the table: whether it is what the planner takes for it, and how high the rest is above it.

If it is not, every answer would be about something else. Frame *table*. A cloud without table points is no reason to
refuse (a filter may have taken them out), unless nothing stands in it either: that a table is empty is said only of a
table that is seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from dgs_description.cloud import squares, voxel_means
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.table_fit import TablePlane, draw_plane, fit_plane

CELL = 0.02
"""Edge of the cubes that a cloud is thinned to, and of squares of table [m]."""
NEAR = 0.025
"""The table is right where points are so near to z = 0: what a hand-eye error does within the workspace [m]."""
LEAST_CELLS = 100
"""Of a seen table on which nothing stands."""
LEAST_POINTS = 4
"""Points per square of table: with fewer, one per centimetre, things cannot be told from noise."""
LARGE = 0.10
"""A plane of this area that is not where the table should be is the table, or hides it [m^2]."""
LEAST_SHARE = 0.35
"""Share of the thinned cloud that it makes up."""
BELOW = 0.03
"""Share of points below a table that is not seen, from which on it is lower than it should be."""
LEVEL, STEEP = float(np.deg2rad(5.0)), float(np.deg2rad(70.0))
"""A plane that is tilted by less is level, by more a wall [rad]."""
HYPOTHESES = 200
FIT_POINTS, LEVEL_POINTS = 40_000, 6000
"""Of a larger cloud every k-th point is looked at: to check the table, and to level it."""
ROUGH = 3.3
"""What stands out of the table by so many times its roughness is no noise."""
RAY, DEEP, CROSSED = 0.006, 0.04, 0.7
"""In this share of squares of the picture, of this edge [rad], points lie so far behind one another [m]: fog."""


def check_table(cloud: NDArray, camera: Array) -> None:
    """Refuse a cloud (N, 3), finite [m], whose largest plane lies where no table should be, or that shows no surfaces.

    Args:
        camera: (3,) its position [m].

    Raises:
        DgsError: CLOUD_NO_TABLE.
    """
    some = cloud[:: -(-len(cloud) // FIT_POINTS)]
    if max(np.ptp(column) for column in some.T) > 20.0:
        return  # refused elsewhere
    thin = voxel_means(some, CELL)
    table = int((np.abs(thin[:, 2]) < NEAR).sum())
    found = _largest_plane(thin)
    if found is not None:
        tilt, height, count = found
        displaced = LEVEL < tilt < STEEP or (tilt <= LEVEL and abs(height) > NEAR)
        if displaced and count > max(table if tilt <= LEVEL else 0, LEAST_SHARE * len(thin), LARGE / CELL**2):
            where = f"tilted by {np.rad2deg(tilt):.0f} degrees, {1e3 * height:.0f} mm above where the table should be"
            raise _no_table(f"the largest plane is {where}: calibrate the camera, or set the table's height")
    share = _crossed(some, camera)
    if share > CROSSED:
        raise _no_table(
            f"neighbouring rays differ by more than {1e3 * DEEP:.0f} mm in {share:.0%} of the picture, as in fog: "
            "clean the lens, check exposure and projector"
        )
    _check_hidden_table(some, thin)


def levelled(points: NDArray, camera: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The cloud with heights above the table as seen, and how high each point is no table.

    A hand-eye error of one degree puts the table's far end 7 mm up, and noise grows with the square of the distance:
    both would pass for things that lie there.

    Args:
        points: (N, 3) finite, in the frame *table*, right within 25 mm [m].
        camera: (3,) its position there [m].

    Returns:
        The cloud (N, 3), and (N,) at least `OBJECT_HEIGHT` [m].
    """
    cloud = np.asarray(points, dtype=np.float32)
    least = np.full(len(cloud), OBJECT_HEIGHT, dtype=np.float32)
    thin = cloud[:: -(-len(cloud) // LEVEL_POINTS)]
    square, bare, _ = _squares_of_table(thin)
    if bare.sum() < LEAST_CELLS:
        return cloud, least  # the pose is taken as it is configured
    low = thin[bare[square]]
    above = np.array([0.0, 0.0, 1.0])  # the fit wants its origin above the plane
    plane = fit_plane(low.astype(np.float64) - above, TablePlane(above, 1.0, 0.0, 0.0))

    def far(points: NDArray[np.float32]) -> NDArray[np.float32]:
        x, y, z = (place - at for place, at in zip(points.T, camera.astype(np.float32), strict=True))
        return np.maximum(x * x + y * y + z * z, np.float32(1.0))

    seen = cloud.copy()
    seen[:, 2] = cloud @ plane.normal.astype(np.float32) + np.float32(plane.height - plane.normal[2])
    roughness = 1.48 * float(np.median(np.abs(plane.heights(low - above)) / far(low)))
    return seen, np.maximum(least, ROUGH * roughness * far(cloud))


def why_empty(cloud: NDArray, error: DgsError) -> DgsError:
    """`error` (NO_OBJECTS) where the table is seen, else CLOUD_NO_TABLE; `cloud` (N, 3) without objects [m]."""
    cells, count = _bare_cells(cloud)
    if cells < LEAST_CELLS:
        return _no_table(
            "neither the table nor things on it are seen: check the camera's pose and the workspace"
        )
    if count < LEAST_POINTS:
        few = f"{count:.0f} points per square of {1e3 * CELL:.0f} mm of table"
        return _no_table(f"{few} are too few to tell things from noise: thin the cloud to 5 mm at most")
    return error


def _bare_cells(points: NDArray) -> tuple[int, float]:
    """Number of squares of table on which nothing stands, and the median number of their points (N, 3) [m]."""
    _, bare, count = _squares_of_table(points)
    return int(bare.sum()), float(np.median(count[bare])) if bare.any() else 0.0


def _squares_of_table(points: NDArray) -> tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.int64]]:
    """(N,) square of table in which each of the points (N, 3) [m] lies; (M,) whether nothing stands there, and its
    number of points."""
    square = squares(points[:, :2], CELL)
    high = np.bincount(square, weights=np.abs(points[:, 2]) > NEAR)
    return square, high == 0, np.bincount(square)


def _check_hidden_table(points: NDArray, thin: Array) -> None:
    """What hides the table must be things: none goes on below it, none is as large as a table."""
    bare, _ = _bare_cells(points)
    below = float((points[:, 2] < -OBJECT_HEIGHT).mean())
    if bare < LEAST_CELLS and below > BELOW:
        said = f"no table is seen where it should be, and {below:.0%} of the points are below it"
        raise _no_table(f"{said}: calibrate the camera, or set the table's height")
    square = np.floor(thin[thin[:, 2] > OBJECT_HEIGHT, :2] / CELL).astype(np.int64)
    if not len(square):
        return
    square -= square.min(axis=0)
    covered = np.zeros(square.max(axis=0) + 1, bool)
    covered[tuple(square.T)] = True
    area = CELL**2 * np.bincount(label(covered)[0].ravel())[1:].max()
    if area > max(LARGE, bare * CELL**2):
        raise _no_table(
            f"something of {area:.2f} m^2 hides the table: clear the camera's view, check its pose"
        )


def _no_table(why: str) -> DgsError:
    return DgsError(ErrorCode.CLOUD_NO_TABLE, why)


def _largest_plane(thin: Array) -> tuple[float, float, int] | None:
    """Tilt [rad], height under its middle [m], and number of points of the plane that holds most of (N, 3) [m]."""
    if len(thin) < LARGE / CELL**2:
        return None
    rng = np.random.default_rng(0)
    sample = thin[rng.choice(len(thin), min(len(thin), 1500), replace=False)]
    found = draw_plane(sample, CELL / 2, HYPOTHESES, rng)
    if found is None:
        return None
    normal, offset = found
    near = np.abs(thin @ normal + offset) < CELL / 2
    tilt = float(np.arccos(min(abs(normal[2]), 1.0)))
    return tilt, float(np.median(thin[near, 2])), int(near.sum())


def _crossed(points: NDArray, camera: Array) -> float:
    """Share of squares of the picture in which points lie behind one another."""
    ray = (points - camera).astype(np.float32)
    axis = ray.T.mean(axis=1)
    axis /= max(float(np.linalg.norm(axis)), 1e-9)
    ray = ray.compress(ray @ axis > 0.05, axis=0)
    ahead = ray @ axis
    number = squares((ray @ np.linalg.svd(axis[None])[2][1:].T) / ahead[:, None], RAY)
    count = np.bincount(number)
    nearest, farthest = np.full(len(count), np.inf, np.float32), np.zeros(len(count), np.float32)
    np.minimum.at(nearest, number, ahead)
    np.maximum.at(farthest, number, ahead)
    depth = farthest - nearest
    several = count > 1
    return float((depth[several] > DEEP).mean()) if several.any() else 0.0

"""What stands on the table as one height per cell: whether a finger's sphere touches it is one look-up.

What lies under a seen point is taken as solid: a camera above the table sees upper sides, and from above a hand meets
nothing else. What the view does not show is completed (`shape_completion`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, find_objects, gaussian_filter, grey_closing, label
from scipy.spatial import cKDTree

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.shape import Shape
from dgs_grasp_planner.contact.shape_completion import NOTHING, REACH, complete, on_grid
from dgs_grasp_planner.contact.things import CELL, MIN_CELLS

Floats = NDArray[np.float32]
Index = NDArray[np.int64]

GAP = 5
"""Gaps narrower than this are closed: rows of pixels on a top seen at a low angle stand 6 mm apart [cells]."""
FLOOR, FLOOR_POINTS = 0.003, 100
"""Mean height of so many points within a rim, from which on they are no table [m].

Four plates had 4.1 to 5.8 mm in 31 views, three rolls of tape up to 2.8 mm.
"""
RELIEF = 0.012
"""What is higher within a plate's rim lies on the plate; what is lower is its floor and noise [m]."""
NEAR = 0.05
"""A hand grasps at the thing that is next to its TCP, if it is no farther away than this [m]."""
BLUR = 1.5
"""Of the floor before its slope is taken [cells]."""
_RADII = tuple(capsule.radius for capsule in HAND.capsules[0])


@dataclass(frozen=True)
class HeightField:
    """Heights of the objects over a grid, frame *table*.

    Attributes:
        low: (2,) corner of cell (0, 0) [m].
        heights: (X, Y) highest point of every cell, `NOTHING` where there is none [m].
        floors: (3, X, Y) per phalanx: the lowest that the centre of one of its spheres may be above a cell [m].
        feared: (3, X, Y) the same above all that may be there.
        slope: (2, X, Y) of the distal phalanx' floor, smoothed [m/m].
        owner: (X, Y) number of the connected shape that covers a cell, 0 = none.
        things: (X, Y) the same of single things, of which a shape may be several, or a part.
    """

    low: Array
    heights: Floats
    floors: Floats
    feared: Floats
    slope: Floats
    owner: NDArray[np.int32]
    things: NDArray[np.int32]

    def cells(self, points: NDArray) -> Index:
        """(...) flat cell of (..., >= 2) points [m]; outside of the grid its border, where nothing stands."""
        width, depth = self.heights.shape
        x = np.clip((points[..., 0] - self.low[0]) / CELL, 0, width - 1).astype(np.int64)
        return x * depth + np.clip((points[..., 1] - self.low[1]) / CELL, 0, depth - 1).astype(np.int64)

    def clearance(self, spheres: NDArray, feared: bool = False) -> Floats:
        """(..., S) height of every sphere of a finger above the objects, negative = inside [m].

        Args:
            spheres: (..., S, 3) centres in the order of `HAND.sphere_radii` [m].
            feared: above what may be there, too.
        """
        floors = self.feared if feared else self.floors
        floor = floors.ravel()[self.cells(spheres) + HAND.sphere_phalanx * self.heights.size]
        return np.asarray(spheres[..., 2] - floor)

    def normals(self, centres: NDArray) -> Array:
        """(..., 3) unit normals where spheres with these centres touch: horizontal at walls, up on tops."""
        dx, dy = self.slope.reshape(2, -1)[:, self.cells(centres)]
        normal = np.stack([-dx, -dy, np.ones(dx.shape)], axis=-1)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    @cached_property
    def separated(self) -> HeightField:
        """The same with things instead of shapes."""
        return replace(self, owner=self.things)

    def nearest(self, places: Array, reach: float) -> NDArray[np.int32]:
        """(N,) numbers of the shapes that are nearest to places (N, >= 2), 0 = none within `reach` [m]."""
        cells = np.argwhere(self.owner > 0)
        numbers = np.append(self.owner[tuple(cells.T)], 0)
        _, cell = cKDTree(self.middles(cells)).query(places[:, :2], distance_upper_bound=reach)
        return numbers[cell]

    @cached_property
    def shapes(self) -> dict[int, Shape]:
        """All shapes by number, ascending."""
        cells = np.argwhere(self.owner > 0)
        owner = self.owner[tuple(cells.T)]
        own = {number: cells[owner == number] for number in np.unique(owner).tolist()}
        return {k: Shape(k, each, self.middles(each), self.heights[tuple(each.T)]) for k, each in own.items()}

    @cached_property
    def centres(self) -> Array:
        """(M + 1, 2) middle of every shape's cells [m]; row 0 belongs to none."""
        cells = np.argwhere(self.owner > 0)
        number = self.owner[tuple(cells.T)]
        count = np.maximum(np.bincount(number, minlength=1), 1)
        sums = [np.bincount(number, column, len(count)) for column in self.middles(cells).T]
        return np.stack(sums, axis=1) / count[:, None]

    def between(self, one: Array, other: Array) -> tuple[NDArray[np.int32], Array]:
        """The shape between contacts (N, 3) on two sides: at their middle; where that is empty, as between the prongs
        of a fork, on both sides of it.

        Returns:
            (N,) its number, 0 = none, or two; (N, 3) the point of the line nearest to the middle where it stands.
        """
        sides, points = [], one
        for start, end in ((other, one), (one, other)):
            way = start + np.linspace(0.5, 0.1, 5)[:, None, None] * (end - start)
            owner = self.owner.ravel()[self.cells(way)]
            first, column = (owner > 0).argmax(axis=0), np.arange(len(one))
            points = way[first, column]
            sides.append(owner[first, column])
        return np.where(sides[0] == sides[1], sides[0], 0), points

    def middles(self, cells: Index) -> Array:
        """(M, 2) middles of cells (M, 2) [m]."""
        return np.asarray(self.low + (cells + 0.5) * CELL)

    def top(self, points: NDArray) -> Floats:
        """(...) height at (..., >= 2) points [m]."""
        return np.asarray(self.heights.ravel()[self.cells(points)])


def height_field(
    cloud: NDArray,
    camera: Array | None = None,
    table: NDArray | None = None,
    plates: bool = False,
    least: float = OBJECT_HEIGHT,
) -> HeightField:
    """The height field of a cloud.

    Args:
        cloud: (N, 3) [m], frame *table*.
        camera: (3,) its position [m]; None = what is not seen is not there, and what is joined is one thing.
        table: (M, 3) [m] points that were taken for the table.
        plates: where a rim is around such points they may be a plate's floor.
        least: points of the cloud that are lower are not looked at [m].

    Raises:
        DgsError: NO_OBJECTS; nothing is higher than `least`.
    """
    found = seen_heights(cloud, 0.0 if camera is None else REACH, least)
    if found is None:
        raise DgsError(ErrorCode.NO_OBJECTS, "nothing stands on the table")
    heights, owner, low = found
    bare = np.zeros((0, 3), np.float32) if table is None else table
    feared, things = heights, owner
    if camera is not None:
        heights, feared, owner, things = complete(heights, owner, cloud, bare, camera, low)
    if plates:
        _fill_plates(heights, owner, things, bare, low)
    floors = _floors(heights)
    above = floors if camera is None else _floors(np.maximum(feared, heights))
    slope = np.stack(np.gradient(gaussian_filter(np.maximum(floors[-1], 0.0), BLUR), CELL))
    return HeightField(low, heights, floors, above, slope.astype(np.float32), owner, things)


def seen_heights(
    cloud: NDArray, margin: float, least: float = OBJECT_HEIGHT
) -> tuple[Floats, NDArray[np.int32], Array] | None:
    """What is seen of things: (X, Y) heights and owners as in `HeightField`, (2,) `low`; None = nothing stands there.

    Args:
        cloud: (N, 3) [m], frame *table*.
        margin: around the seen points for what is hidden [m].
        least: what is lower is table [m].
    """
    points = cloud[cloud[:, 2] > least]
    if not len(points):
        return None
    reach = int(np.ceil(max(_RADII) / CELL)) + 2 + int(margin / CELL)
    low = points[:, :2].min(axis=0).astype(np.float64) - reach * CELL
    cell = ((points[:, :2] - low) / CELL).astype(np.int64)
    width, depth = (cell.max(axis=0) + reach + 1).tolist()
    heights = np.full((width, depth), NOTHING, dtype=np.float32)
    np.maximum.at(heights, (cell[:, 0], cell[:, 1]), points[:, 2].astype(np.float32))
    heights = grey_closing(heights, size=(GAP, GAP))
    owner, count = label(heights > 0, structure=np.ones((3, 3)))
    small = np.bincount(owner.ravel(), minlength=count + 1) < MIN_CELLS
    heights[small[owner]] = NOTHING
    owner[small[owner]] = 0
    return heights, owner, low


def _fill_plates(
    heights: Floats, owner: NDArray[np.int32], things: NDArray[np.int32], points: NDArray, low: Array
) -> None:
    """Give shapes the floor that lies within their rim, in place; what has none is a ring.

    Args:
        heights, owner, things: (X, Y) as in `HeightField`.
        points: (M, 3) low points [m].
        low: (2,) corner of cell (0, 0) [m].
    """
    (x, y), z = on_grid(points, heights.shape, low)
    for number, window in enumerate(find_objects(owner), start=1):
        if window is None:
            continue
        rim = owner[window] == number
        within = binary_fill_holes(rim) & ~rim
        standing, count = label(within & (heights[window] >= RELIEF), structure=np.ones((3, 3)))
        noise = np.bincount(standing.ravel(), minlength=count + 1) < MIN_CELLS
        noise[0] = True  # what is low
        hole = np.zeros(owner.shape, bool)
        hole[window] = within & noise[standing]
        floor = z[hole[x, y]]
        if len(floor) >= FLOOR_POINTS and floor.mean() > FLOOR:
            heights[hole] = np.maximum(heights[hole], floor.mean())
            owner[hole], things[hole] = number, np.bincount(things[window][rim]).argmax()


def _floors(heights: Floats) -> Floats:
    """(3, X, Y) grey dilation by a ball of each phalanx' radius."""
    reach = int(max(_RADII) / CELL)
    width, depth = heights.shape
    wide = np.pad(heights, reach, constant_values=NOTHING)
    rings: dict[int, Floats] = {}  # by squared distance: highest of the cells that lie so far away
    for i, j in np.ndindex(2 * reach + 1, 2 * reach + 1):
        square, there = (i - reach) ** 2 + (j - reach) ** 2, wide[i : i + width, j : j + depth]
        rings[square] = np.maximum(rings[square], there) if square in rings else there
    out = np.full((len(_RADII), width, depth), NOTHING, dtype=np.float32)
    for radius, floor in zip(_RADII, out, strict=True):
        for square, ring in rings.items():
            up = radius**2 - square * CELL**2
            if up > 0:
                np.maximum(floor, ring + np.float32(np.sqrt(up)), out=floor)
    return out

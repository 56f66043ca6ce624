"""The things on the table as solid bodies: what the height field says of each, in convex parts for a physics engine."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from dgs_description.frames import Array, transform
from dgs_grasp_planner.contact.height_field import HeightField, Index
from dgs_grasp_planner.contact.things import CELL
from dgs_sim_bridge.render.object_model import ObjectModel

DENSITY, MASSES = 400.0, (0.03, 0.45)
"""Of things nobody has weighed: most are not solid [kg/m^3], and the least and most that one weighs [kg]."""
CONVEX = 1.12
"""A part whose hull has no more than this many times its volume is convex enough."""
CUTS, SMALLEST = 4, 24
"""A thing is cut in two at most so many times over, and a part only if it has so many cells."""
_QUANTILES = (0.3, 0.5, 0.7)
_CORNERS = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])
_DIRECTIONS = 48
"""Of the points that stand for a hull: those that lie farthest in each direction."""


def solid(field: HeightField, number: int) -> tuple[ObjectModel, Array] | None:
    """A thing of a field as a body that is solid down to the table; None where it is but a line of cells.

    Args:
        field: things that touch have been told apart (`HeightField.separated`).
        number: of the thing.

    Returns:
        the body, and (4, 4) where it is, frame *table*.
    """
    cells = field.shape(number)
    heights = field.heights[tuple(cells.T)].astype(np.float64)
    try:
        parts = list(_parts(field.low, cells, heights, CUTS))
    except QhullError:
        return None
    middle = np.append(field.centre_of_mass(number), heights @ heights / heights.sum() / 2)
    own = tuple((part - middle).astype(np.float32) for part in parts)
    hull = ConvexHull(np.concatenate(own))
    mass = float(np.clip(DENSITY * heights.sum() * CELL**2, *MASSES))
    mesh = hull.points.astype(np.float32), hull.simplices.astype(np.int32)
    body = ObjectModel(f"thing {number}", "cuboid", "thing", mass, own, *mesh)
    return body, transform(position=middle)


def _parts(low: Array, cells: Index, heights: Array, cuts: int) -> Iterator[Array]:
    """(V, 3) vertices of convex parts [m], of columns of `heights` (M,) over cells (M, 2)."""
    volume, points = _hull(low, cells, heights)
    if cuts == 0 or len(cells) < SMALLEST or volume < CONVEX * heights.sum() * CELL**2:
        yield points
        return
    best, chosen = 0.97 * volume, None
    for axis in np.linalg.svd(cells - cells.mean(axis=0), full_matrices=False)[2]:
        along = cells @ axis
        for cut in np.quantile(along, _QUANTILES):
            one = along <= cut
            if one.all():
                continue
            try:
                both = sum(_hull(low, cells[half], heights[half])[0] for half in (one, ~one))
            except QhullError:
                continue
            if both < best:
                best, chosen = both, one
    if chosen is None:
        yield points
        return
    for half in (chosen, ~chosen):
        yield from _parts(low, cells[half], heights[half], cuts - 1)


def _hull(low: Array, cells: Index, heights: Array) -> tuple[float, Array]:
    """Volume of the hull of columns [m^3], and (V, 3) points that span it [m]."""
    edges = (low + (cells[:, None] + _CORNERS) * CELL).reshape(-1, 2)
    tops = np.column_stack([edges, np.repeat(heights, len(_CORNERS))])
    points = np.concatenate([tops, tops * (1.0, 1.0, 0.0)])
    spanning = points[np.unique((points @ _directions().T).argmax(axis=0))]
    return float(ConvexHull(spanning).volume), spanning


def _directions() -> Array:
    """(`_DIRECTIONS`, 3) unit vectors, spread evenly."""
    k = np.arange(_DIRECTIONS) + 0.5
    z = 1.0 - 2.0 * k / _DIRECTIONS
    turn = np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z * z)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])

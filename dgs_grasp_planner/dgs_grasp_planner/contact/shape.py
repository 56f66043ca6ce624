"""One of the shapes that stand on the table, as a camera above it shows them: where it is, how wide, how thick."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from dgs_description.frames import Array
from dgs_grasp_planner.contact.things import CELL

THICK = 90
"""Percentile of the heights of a shape's cells that counts as its thickness: single ones are too high by noise."""
HOLLOW, INSIDE, LOW = 0.45, 0.15, 0.025
"""A vessel is lower in its middle than so much of its thickness: within so much of its width, median. Lower things than
the last [m] are none: the camera's noise is too large for them."""
_TURNS = np.deg2rad(np.arange(0.0, 180.0, 5.0))
_CORNERS = np.array(list(product((-CELL / 2, CELL / 2), repeat=2)))


@dataclass(frozen=True, eq=False)
class Shape:
    """Cells of a height field that belong together.

    Attributes:
        number: the shape's, in `HeightField.owner`.
        cells: (N, 2) rows and columns.
        points: (N, 2) middles of the cells [m].
        heights: (N,) of the cells [m].
    """

    number: int
    cells: NDArray[np.int64]
    points: Array
    heights: NDArray[np.float32]

    @property
    def tops(self) -> Array:
        """(N, 3) highest places of the cells [m]."""
        return np.column_stack([self.points, self.heights])

    @cached_property
    def centre_of_mass(self) -> Array:
        """(2,) if it were solid from what is seen down to the table [m]."""
        return np.average(self.points, axis=0, weights=self.heights)

    @cached_property
    def thickness(self) -> float:
        """Height that `THICK` percent of the cells do not exceed [m]."""
        return float(np.percentile(self.heights, THICK))

    @cached_property
    def width(self) -> float:
        """In the horizontal direction in which it is narrowest [m]."""
        across = np.stack([np.cos(_TURNS), np.sin(_TURNS)]) * CELL
        return float(np.ptp(self.cells @ across, axis=0).min() + CELL)

    @cached_property
    def solidity(self) -> float:
        """Share of their convex hull that the cells fill."""
        hull = ConvexHull((self.points[:, None] + _CORNERS).reshape(-1, 2))
        return len(self.points) * CELL**2 / float(hull.volume)

    @cached_property
    def vessel(self) -> bool:
        """Whether it is open above, as a bowl that stands upright: it can be had by its rim."""
        away = np.linalg.norm(self.points - self.centre_of_mass, axis=1)
        inside = self.heights[away < INSIDE * self.width]
        hollow = len(inside) > 0 and np.median(inside) < HOLLOW * self.thickness
        return bool(hollow and self.thickness > LOW)


def near_side(
    points: Array, direction: Array, at: Array, half_width: float, share: float = 0.5, ball: bool = False
) -> float | None:
    """Where along `direction` the side of a shape lies that is met first, near a line through `at`.

    The quantile `share` over strips beside each other: single cells stick out by noise.

    Args:
        points: (N, 2) cells of the shape [m].
        direction: (2,) unit vector, at: (2,) where the way along it is 0 [m].
        half_width: of the band around the line that counts [m].
        share: the quantile.
        ball: it is met by a ball of radius `half_width`; what lies off its line is met later.

    Returns:
        [m], of the front of what meets it; None where the band is empty.
    """
    along, across = np.stack([direction, (-direction[1], direction[0])]) @ (points - at).T
    inside = np.abs(across) < half_width
    if not inside.any():
        return None
    along, across = along[inside], across[inside]
    if ball:
        along = along + half_width - np.sqrt(half_width**2 - across**2)
    strip = np.round(across / CELL).astype(int)
    strip -= strip.min()
    first = np.full(strip.max() + 1, np.inf)
    np.minimum.at(first, strip, along)
    first = np.sort(first[first < np.inf])
    return float(np.interp(share * (len(first) - 1), np.arange(len(first)), first))

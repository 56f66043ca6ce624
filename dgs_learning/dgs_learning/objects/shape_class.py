"""Guesses the shape class of a mesh from its extents and how it fills them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

HOLLOW = 0.5
"""Share of the convex hull below which something is a vessel, if it is not long."""
LONG = 2.2
"""Ratio of the two largest extents above which something is long."""
THIN = 0.037
"""A long thing whose smallest extent is below this is a stick [m]."""
ROUND_FILL = 0.66
"""A ball fills pi/6 = 0.52 of its box, a cylinder pi/4 = 0.79."""
CYLINDER_FILL = 0.85
SQUARE = 1.25
"""Two extents with a ratio below this count as equal."""
COMPACT = 1.8
"""Ratio of largest to smallest extent below which something can be a sphere."""


def guess_shape_class(extents: ArrayLike, volume: float, hull_volume: float) -> str:
    """One of `SHAPE_CLASSES`: a rule of thumb, to be overruled by the person who knows the object.

    Args:
        extents: three edges of the oriented box [m].
        volume, hull_volume: of the mesh and of its convex hull [m^3].
    """
    a, b, c = np.sort(extents)
    fill = hull_volume / (a * b * c)
    if c / b > LONG and a < THIN:
        return "stick"
    if volume / hull_volume < HOLLOW:
        return "bowl"
    if c / a < COMPACT and fill < ROUND_FILL:
        return "sphere"
    if fill < CYLINDER_FILL and (b / a < SQUARE or c / b < SQUARE):
        return "cylinder"
    return "cuboid"

"""Families that are broader than the hand opens, whichever way they lie: what not to grasp, for training."""

from __future__ import annotations

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.families import Family, draw
from dgs_learning.objects.shapes import Parts


def crate(rng: np.random.Generator) -> Parts:
    """A large box."""
    return shapes.box(rng.uniform(0.1, 0.18, 3), draw(rng, 0.0, 0.008))


def parcel(rng: np.random.Generator) -> Parts:
    """A large box that bulges."""
    return shapes.superquadric(rng.uniform(0.055, 0.085, 3), draw(rng, 0.2, 0.6), draw(rng, 0.2, 0.6))


def canister(rng: np.random.Generator) -> Parts:
    """A thick drum with a bevelled top and bottom."""
    r, h, bevel = draw(rng, 0.052, 0.08), draw(rng, 0.11, 0.18), draw(rng, 0.0, 0.015)
    profile = [(r - bevel, 0), (r, bevel), (r, h - bevel), (r - bevel, h)]
    return shapes.lathe(profile if bevel > 0.002 else [(r, 0), (r, h)], sectors=20)


def football(rng: np.random.Generator) -> Parts:
    """A large ball, or nearly."""
    return shapes.superquadric(draw(rng, 0.055, 0.08) * rng.uniform(0.92, 1.08, 3), 1.0, 1.0, rings=11)


OVERSIZE: dict[str, tuple[Family, ...]] = {
    "cuboid": (crate, parcel),
    "cylinder": (canister,),
    "sphere": (football,),
}

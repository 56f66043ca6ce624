"""Objects as no catalogue has them: stretched along their axes, and of another density."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_sim_bridge.render.object_model import ObjectModel

STRETCH, EDGES = (0.3, 1.6), (0.008, 0.24)
"""Factors, whose logarithms are uniform, and edges of the box around what comes out [m]."""
HEAVIER, MASSES = (0.5, 4.0), (0.015, 0.6)
"""Factor on the density, and masses [kg]."""


def stretched(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """An object with each axis stretched by a factor of its own, to be flat, wide, thin or long; another density."""
    size, (shortest, longest) = np.ptp(model.bounds, axis=0).astype(np.float64), np.log(STRETCH)
    factors = np.clip(size * np.exp(rng.uniform(shortest, longest, 3)), *EDGES) / size
    mass = model.mass * factors.prod() * float(np.exp(rng.uniform(*np.log(HEAVIER))))
    return replace(
        model,
        mass=float(np.clip(mass, *MASSES)),
        parts=tuple((part * factors).astype(np.float32) for part in model.parts),
        vertices=(model.vertices * factors).astype(np.float32),
    )

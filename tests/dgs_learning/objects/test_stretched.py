"""Stretched objects."""

from __future__ import annotations

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.stretched import EDGES, MASSES, stretched
from dgs_sim_bridge.render.object_model import from_parts


def test_stretched_objects_keep_their_middle_and_stay_within_bounds() -> None:
    block = from_parts("block", "cuboid", "block", shapes.box([0.05, 0.06, 0.08]), 0.2)
    many = [stretched(block, np.random.default_rng(k)) for k in range(60)]
    sizes = np.array([np.ptp(m.bounds, axis=0) for m in many])
    assert sizes.min() >= EDGES[0] - 1e-6 and sizes.max() <= EDGES[1] + 1e-6
    assert (sizes.min(axis=1) < 0.03).mean() > 0.3, "flat and thin ones"
    assert all(np.abs(m.bounds.mean(axis=0)).max() < 1e-6 for m in many)
    masses = np.array([m.mass for m in many])
    assert masses.min() >= MASSES[0] and masses.max() <= MASSES[1] and masses.std() > 0.03

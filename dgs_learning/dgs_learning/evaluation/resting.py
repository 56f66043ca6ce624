"""How an object lies, as far as a hand cares: it fits, it is low, or it is wider than the hand opens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dgs_description.hand import HAND
from dgs_learning.synthesis.scenes import make_scene
from dgs_sim_bridge.render.object_model import ObjectModel

KINDS = ("fits", "low", "wide")
LOW = 0.035
"""[m]"""
_TURNS = np.deg2rad(np.arange(0.0, 180.0, 3.0))


def resting_kind(model: ObjectModel, T_table_object: NDArray[np.float64]) -> str:
    """One of `KINDS`.

    "wide": no horizontal direction across the object is under the hand's opening; else "low": lower than `LOW`.

    Args:
        T_table_object: (4, 4) as it lies.
    """
    there = model.vertices @ T_table_object[:3, :3].T
    across = there[:, :2] @ np.stack([np.cos(_TURNS), np.sin(_TURNS)])
    if np.ptp(across, axis=0).min() > HAND.grasp.widest:
        return "wide"
    return "low" if there[:, 2].max() + T_table_object[2, 3] < LOW else "fits"


def dropped_kinds(models: Sequence[ObjectModel], drops: int = 5) -> Counter[str]:
    """How often the objects came to rest in each of `KINDS`, every one dropped alone so many times."""
    found = Counter(dict.fromkeys(KINDS, 0))
    for k, model in enumerate(models):
        for drop in range(drops):
            found.update(
                resting_kind(model, T) for T in make_scene(models, [k], [105, k, drop]).T_table_object
            )
    return found

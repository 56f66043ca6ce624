"""Multi-object scenes: objects dropped one after another onto a table until they lie still (paper, section V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array, transform
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.scenes import SettlingTable, random_orientation

STILL = (0.02, 0.3)
"""An object that moves slower than this lies still [m/s], [rad/s]."""


@dataclass(frozen=True)
class Scene:
    """A settled scene in the frame *table* (z = 0 is the table top).

    Attributes:
        objects: (N,) index of each object in its catalogue.
        T_table_object: (N, 4, 4) poses.
    """

    objects: NDArray[np.int64]
    T_table_object: Array


def drop_pose(rng: np.random.Generator, model: ObjectModel, area: Sequence[float]) -> Array:
    """A pose above the table, of a `random_orientation`."""
    rotation = random_orientation(rng)
    low = float((model.vertices @ rotation.T)[:, 2].min())
    half = np.array(area) / 2 - 0.04
    return transform(rotation, (*rng.uniform(-half, half), 0.04 - low))


def make_scene(
    models: Sequence[ObjectModel],
    objects: Sequence[int],
    seed: Sequence[int],
    area: Sequence[float] = (0.6, 0.6),
) -> Scene:
    """Drop objects and let them settle; those that leave the area or never come to rest are left out.

    Args:
        models: of the catalogue.
        objects: indices into it, in the order of dropping.
        area: x and y extent of the workspace [m].
    """
    rng = np.random.default_rng(list(seed))
    with SettlingTable() as table:
        for k in objects:
            table.add(models[k], drop_pose(rng, models[k], area))
            table.step(60)
        for _ in range(8):
            table.step(60)
            if table.still(*STILL).all():
                break
        poses = table.poses()
        inside = (np.abs(poses[:, :2, 3]) < np.array(area) / 2 + 0.02).all(1) & (poses[:, 2, 3] > 0)
        keep = np.flatnonzero(inside & table.still(*STILL))
        return Scene(np.asarray(objects)[keep], poses[keep])

"""Multi-object scenes: objects dropped one after another onto a table until they lie still (paper, section V-B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pybullet
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_sim_bridge.object_model import ObjectModel
from dgs_sim_bridge.physics import PHYSICS, add_object, body_pose, new_client

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """A settled scene in the frame *table* (z = 0 is the table top).

    Attributes:
        objects: (N,) index of each object in its catalogue.
        T_table_object: (N, 4, 4) poses.
    """

    objects: NDArray[np.int64]
    T_table_object: Array


def add_table(client: int) -> int:
    """A table top at z = 0 without edges."""
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    body = pybullet.createMultiBody(0, plane, physicsClientId=client)
    pybullet.changeDynamics(body, -1, lateralFriction=PHYSICS.table_friction, physicsClientId=client)
    return body


def drop_pose(
    rng: np.random.Generator, model: ObjectModel, area: Sequence[float], upright_share: float = 0.5
) -> Array:
    """A pose above the table: upright as modelled or in any orientation, any heading."""
    if rng.random() < upright_share:
        rotation = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    else:
        rotation = Rotation.random(rng=rng).as_matrix()
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
        models: the catalogue.
        objects: indices into it, in the order of dropping.
        seed: key of the scene.
        area: x and y extent of the workspace [m].
    """
    rng = np.random.default_rng(list(seed))
    client = new_client()
    try:
        pybullet.setGravity(0, 0, -PHYSICS.gravity, physicsClientId=client)
        add_table(client)
        bodies = []
        for k in objects:
            bodies.append(add_object(client, models[k], drop_pose(rng, models[k], area)))
            _run(client, 60)
        for _ in range(8):
            _run(client, 60)
            if all(_is_still(client, body) for body in bodies):
                break
        poses = np.array([body_pose(client, body) for body in bodies])
        inside = (np.abs(poses[:, :2, 3]) < np.array(area) / 2 + 0.02).all(1) & (poses[:, 2, 3] > 0)
        still = np.array([_is_still(client, body) for body in bodies])
        keep = np.flatnonzero(inside & still)
        return Scene(np.asarray(objects)[keep], poses[keep])
    finally:
        pybullet.disconnect(physicsClientId=client)


def _run(client: int, steps: int) -> None:
    for _ in range(steps):
        pybullet.stepSimulation(physicsClientId=client)


def _is_still(client: int, body: int) -> bool:
    linear, angular = pybullet.getBaseVelocity(body, physicsClientId=client)
    return float(np.linalg.norm(linear)) < 0.02 and float(np.linalg.norm(angular)) < 0.3

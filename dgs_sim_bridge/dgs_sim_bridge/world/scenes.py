"""Random tabletop scenes: objects dropped one after another and settled, without a robot. Frame: `table`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pybullet
from numpy.typing import NDArray
from pybullet_utils.bullet_client import BulletClient
from scipy.spatial.transform import Rotation

from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import (
    PHYSICS,
    PhysicsSettings,
    add_object,
    body_pose,
    new_world,
    set_body_pose,
)

MAX_OBJECTS = 30
CLEARANCE = 0.02
"""Gap between the circumscribed circles of objects [m]."""
_FAR = 2.0
"""Half extents of a table of which one edge matters [m]."""
_TRIES = 60
_REDROPS = 6
_ASIDE, _JUST_ABOVE = (5.0, 5.0), 0.003
"""Where an object comes to rest before it is put among the others, and how low it is let go [m]."""


@dataclass(frozen=True)
class PlacedObject:
    """An object and where it stands: T_frame_object (4, 4) in the frame that the context names."""

    model: ObjectModel
    pose: Array


class SettlingTable:
    """A table top at z = 0 without edges and without a robot, on which objects come to rest; a context manager."""

    def __init__(self) -> None:
        self.bullet = new_world()
        self.bullet.setGravity(0, 0, -PHYSICS.gravity)
        add_table(self.bullet)
        self.bodies: list[int] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.bullet.disconnect()

    def add(self, model: ObjectModel, T_table_object: Array) -> int:
        """Put an object there; returns its body."""
        self.bodies.append(add_object(self.bullet, model, T_table_object))
        return self.bodies[-1]

    def step(self, steps: int) -> None:
        """Let time pass."""
        for _ in range(steps):
            self.bullet.stepSimulation()

    def poses(self) -> Array:
        """(N, 4, 4) T_table_object in the order of adding."""
        return np.array([body_pose(self.bullet, body) for body in self.bodies]).reshape(-1, 4, 4)

    def still(self, linear: float, angular: float) -> NDArray[np.bool_]:
        """(N,) whether an object moves slower than `linear` [m/s] and `angular` [rad/s]."""
        speeds = [self.bullet.getBaseVelocity(body) for body in self.bodies]
        slow = np.linalg.norm(np.reshape(speeds, (-1, 2, 3)), axis=2) < (linear, angular)
        return np.asarray(slow.all(axis=1))


def add_table(bullet: BulletClient, settings: PhysicsSettings = PHYSICS, edge: float | None = None) -> int:
    """A table top at z = 0, without edges or where x >= `edge` [m]; returns its body."""
    if edge is None:
        top, middle = bullet.createCollisionShape(pybullet.GEOM_PLANE), np.zeros(3)
    else:
        middle, half = table_top(edge)
        top = bullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half)
    body = int(bullet.createMultiBody(0, top, basePosition=middle))
    bullet.changeDynamics(body, -1, lateralFriction=settings.table_friction)
    return body


def table_top(edge: float) -> tuple[Array, Array]:
    """Middle and half extents (3,) of a table top at z = 0 that begins at x = `edge` [m]."""
    thickness = CELL.table_size[2]
    return np.array([edge + _FAR, 0.0, -thickness / 2]), np.array([_FAR, _FAR, thickness / 2])


def choose_models(
    catalogue: Sequence[ObjectModel], count: int, rng: np.random.Generator
) -> list[ObjectModel]:
    """Random objects of a catalogue, all different as long as there are enough; repeated ones get a numbered name.

    Raises:
        DgsError: the count is out of range or the catalogue is empty.
    """
    if not 0 <= count <= MAX_OBJECTS:
        wrong = f"{count} objects were asked for, 0 to {MAX_OBJECTS} are possible"
        raise DgsError(ErrorCode.SIM_REQUEST, wrong)
    if count and not catalogue:
        raise DgsError(ErrorCode.SIM_CATALOGUE, "the catalogue has no objects")
    rounds = [rng.permutation(len(catalogue)) for _ in range(-(-count // max(len(catalogue), 1)))]
    chosen = [(catalogue[k], n) for n, order in enumerate(rounds) for k in order][:count]
    return [model if n == 0 else replace(model, name=f"{model.name}#{n + 1}") for model, n in chosen]


def drop_scene(
    models: Sequence[ObjectModel],
    rng: np.random.Generator,
    area: tuple[float, float] = CELL.workspace_size,
) -> list[PlacedObject]:
    """Drop objects onto an empty table and wait until they are still.

    Every object first comes to rest alone, from a `random_orientation`. So it is put at a random place that keeps
    `CLEARANCE` to the others where there is room, on top of them where there is none. What rolls out of the area is
    dropped again.

    Args:
        models: objects, in the order of dropping.
        rng: source of all randomness; the same state gives the same scene, bit by bit.
        area: x, y extent of the area around the table frame's origin [m].

    Returns:
        The objects with their poses in the `table` frame.

    Raises:
        DgsError: an object would not stay in the area.
    """
    with _Dropper(rng, area) as table:
        return table.drop(models)


class _Dropper(SettlingTable):
    def __init__(self, rng: np.random.Generator, area: tuple[float, float]) -> None:
        super().__init__()
        self.rng, self.half = rng, np.asarray(area, float) / 2
        self.models: list[ObjectModel] = []

    def drop(self, models: Sequence[ObjectModel]) -> list[PlacedObject]:
        for k, model in enumerate(models):
            self.add(model, transform(position=(*_ASIDE, 0.0)))
            self.models.append(model)
            self._put(k)
        for _ in range(_REDROPS):
            self.settle(4.0)
            poses = self.poses()
            away = [k for k, T_table_object in enumerate(poses) if not self._inside(T_table_object)]
            if not away:
                return [PlacedObject(*placed) for placed in zip(self.models, poses, strict=True)]
            for k in away:
                self._put(k)
        names = ", ".join(self.models[k].name for k in away)
        gone = f"these objects did not stay on the table: {names}; try another seed"
        raise DgsError(ErrorCode.SIM_SCENE, gone)

    def settle(self, limit: float) -> None:
        """Step until nothing has moved for 0.1 s, at most `limit` seconds."""
        quiet = 0
        for _ in range(int(limit / PHYSICS.time_step / 8)):
            self.step(8)
            quiet = quiet + 1 if self.still(0.003, 0.05).all() else 0
            if quiet >= 3:
                return

    def _inside(self, T_table_object: Array) -> bool:
        position = T_table_object[:3, 3]
        return bool(np.all(np.abs(position[:2]) <= self.half) and position[2] > -0.01)

    def _put(self, own: int) -> None:
        model, body = self.models[own], self.bodies[own]
        rotation = random_orientation(self.rng)
        lowest = float((model.vertices @ rotation.T)[:, 2].min())
        set_body_pose(self.bullet, body, transform(rotation, (*_ASIDE, _JUST_ABOVE - lowest)))
        self.settle(1.5)
        set_body_pose(self.bullet, body, self._place(own, body_pose(self.bullet, body)[:3, :3]))
        self.settle(1.5)

    def _place(self, own: int, rotation: Array) -> Array:
        vertices = self.models[own].vertices @ rotation.T
        radius = float(np.linalg.norm(vertices[:, :2], axis=1).max())
        taken = self._circles(own)
        room = np.maximum(self.half - min(radius, 0.06), 0.0)
        places = self.rng.uniform(-room, room, size=(_TRIES, 2))
        if not len(taken):
            place, gap = places[0], np.inf
        else:
            distance = np.linalg.norm(places[:, None] - taken[None, :, :2], axis=-1)
            gaps = (distance - taken[:, 2] - radius).min(1)
            free = np.flatnonzero(gaps >= CLEARANCE)
            index = int(free[0]) if len(free) else int(np.argmax(gaps))
            place, gap = places[index], gaps[index]
        height = _JUST_ABOVE - vertices[:, 2].min()
        if gap < 0:  # no room beside the others: start above them
            height += float(taken[:, 3].max())
        return transform(rotation, (*place, height))

    def _circles(self, own: int) -> Array:
        """x, y, radius and top of every object already there, (N, 4)."""
        rows = []
        for k, (model, T_table_object) in enumerate(zip(self.models, self.poses(), strict=True)):
            if k != own:
                vertices = model.vertices @ T_table_object[:3, :3].T
                radius = np.linalg.norm(vertices[:, :2], axis=1).max()
                top = T_table_object[2, 3] + vertices[:, 2].max()
                rows.append((*T_table_object[:2, 3], radius, top))
        return np.array(rows).reshape(-1, 4)


def random_orientation(rng: np.random.Generator) -> Array:
    """Rotation (3, 3) of a dropped object: half of the time upright as modelled, else any; any heading."""
    if rng.random() < 0.5:
        return np.asarray(Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix())
    return np.asarray(Rotation.random(rng=rng).as_matrix())

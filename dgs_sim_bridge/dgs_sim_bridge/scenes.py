"""Random tabletop scenes: objects dropped one after another and settled, without a robot. Frame: `table`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pybullet
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_sim_bridge.object_model import ObjectModel
from dgs_sim_bridge.physics import PHYSICS, PhysicsSettings, add_object, body_pose, new_client, set_body_pose

Array = NDArray[np.float64]

MAX_OBJECTS = 30
_TRIES = 60
_REDROPS = 6


@dataclass(frozen=True)
class PlacedObject:
    """An object and where it stands: T_frame_object (4, 4) in the frame that the context names."""

    model: ObjectModel
    pose: Array


def choose_models(
    catalogue: Sequence[ObjectModel], count: int, rng: np.random.Generator
) -> list[ObjectModel]:
    """Random objects of a catalogue, all different as long as there are enough; repeated ones get a numbered name.

    Raises:
        DgsError: the count is out of range or the catalogue is empty.
    """
    if not 0 <= count <= MAX_OBJECTS:
        raise DgsError(
            ErrorCode.SIM_REQUEST, f"{count} objects were asked for, 0 to {MAX_OBJECTS} are possible"
        )
    if count and not catalogue:
        raise DgsError(ErrorCode.SIM_CATALOGUE, "the catalogue has no objects")
    rounds = [rng.permutation(len(catalogue)) for _ in range(-(-count // max(len(catalogue), 1)))]
    chosen = [(int(k), n) for n, order in enumerate(rounds) for k in order][:count]
    models = [(catalogue[k], n) for k, n in chosen]
    return [model if n == 0 else replace(model, name=f"{model.name}#{n + 1}") for model, n in models]


def drop_scene(
    models: Sequence[ObjectModel],
    rng: np.random.Generator,
    area: tuple[float, float] = (0.40, 0.80),
    clearance: float = 0.02,
    settings: PhysicsSettings = PHYSICS,
) -> list[PlacedObject]:
    """Drop objects onto an empty table and wait until they are still.

    Every object starts on a random face (likelier the larger it is) a few millimetres above the table, at a random
    place that keeps `clearance` to the others where there is room, on top of them where there is none. What rolls
    out of the area is dropped again.

    Args:
        models: objects, in the order of dropping.
        rng: source of all randomness; the same state gives the same scene, bit by bit.
        area: x, y extent of the area around the table frame's origin [m].
        clearance: gap between the objects' circumscribed circles [m].

    Returns:
        The objects with their poses in the `table` frame.

    Raises:
        DgsError: an object would not stay in the area.
    """
    client = new_client(settings)
    try:
        return _Dropper(client, rng, area, clearance, settings).drop(models)
    finally:
        pybullet.disconnect(physicsClientId=client)


class _Dropper:
    def __init__(
        self,
        client: int,
        rng: np.random.Generator,
        area: tuple[float, float],
        clearance: float,
        settings: PhysicsSettings,
    ) -> None:
        self.client, self.rng, self.clearance, self.settings = client, rng, clearance, settings
        self.half = np.asarray(area, float) / 2
        pybullet.setGravity(0, 0, -settings.gravity, physicsClientId=client)
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=[1.5, 1.5, 0.05], physicsClientId=client
        )
        table = pybullet.createMultiBody(0, shape, basePosition=[0, 0, -0.05], physicsClientId=client)
        pybullet.changeDynamics(table, -1, lateralFriction=settings.table_friction, physicsClientId=client)
        self.bodies: list[tuple[ObjectModel, int]] = []

    def drop(self, models: Sequence[ObjectModel]) -> list[PlacedObject]:
        for model in models:
            body = add_object(self.client, model, self._start(model), self.settings)
            self.bodies.append((model, body))
            self.settle(1.5)
        for _ in range(_REDROPS):
            self.settle(4.0)
            away = [(model, body) for model, body in self.bodies if not self._inside(body)]
            if not away:
                return [PlacedObject(model, body_pose(self.client, body)) for model, body in self.bodies]
            for model, body in away:
                set_body_pose(self.client, body, transform(position=(5.0, 5.0, 0.0)))
                set_body_pose(self.client, body, self._start(model, body))
                self.settle(1.5)
        names = ", ".join(model.name for model, _ in away)
        raise DgsError(
            ErrorCode.SIM_SCENE, f"these objects did not stay on the table: {names}; try another seed"
        )

    def settle(self, limit: float) -> None:
        """Step until nothing has moved for 0.1 s, at most `limit` seconds."""
        quiet = 0
        for step in range(int(limit / self.settings.time_step)):
            pybullet.stepSimulation(physicsClientId=self.client)
            if step % 8 == 7:
                quiet = quiet + 1 if self._still() else 0
                if quiet >= 3:
                    return

    def _still(self) -> bool:
        for _, body in self.bodies:
            linear, angular = pybullet.getBaseVelocity(body, physicsClientId=self.client)
            if np.dot(linear, linear) > 0.003**2 or np.dot(angular, angular) > 0.05**2:
                return False
        return True

    def _inside(self, body: int) -> bool:
        position = body_pose(self.client, body)[:3, 3]
        return bool(np.all(np.abs(position[:2]) <= self.half) and position[2] > -0.01)

    def _start(self, model: ObjectModel, own: int = -1) -> Array:
        rotation = _resting_rotation(model, self.rng)
        vertices = model.vertices @ rotation.T
        radius = float(np.linalg.norm(vertices[:, :2], axis=1).max())
        taken = self._circles(own)
        room = np.maximum(self.half - min(radius, 0.06), 0.0)
        places = self.rng.uniform(-room, room, size=(_TRIES, 2))
        if not len(taken):
            place, gap = places[0], np.inf
        else:
            distance = np.linalg.norm(places[:, None] - taken[None, :, :2], axis=-1)
            gaps = (distance - taken[:, 2] - radius).min(1)
            free = np.flatnonzero(gaps >= self.clearance)
            index = int(free[0]) if len(free) else int(np.argmax(gaps))
            place, gap = places[index], gaps[index]
        height = 0.003 - vertices[:, 2].min()
        if gap < 0:  # no room beside the others: start above them
            height += float(taken[:, 3].max())
        return transform(rotation, (*place, height))

    def _circles(self, own: int) -> Array:
        """x, y, radius and top of every object already there, (N, 4)."""
        rows = []
        for model, body in self.bodies:
            if body != own:
                T_table_object = body_pose(self.client, body)
                vertices = model.vertices @ T_table_object[:3, :3].T
                radius = np.linalg.norm(vertices[:, :2], axis=1).max()
                top = T_table_object[2, 3] + vertices[:, 2].max()
                rows.append((*T_table_object[:2, 3], radius, top))
        return np.array(rows).reshape(-1, 4)


def _resting_rotation(model: ObjectModel, rng: np.random.Generator) -> Array:
    """Rotation that puts a random face of the convex hull down, with a random turn about the vertical."""
    hull = ConvexHull(model.vertices.astype(np.float64))
    corners = hull.points[hull.simplices]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normals = hull.equations[:, :3]
    # Triangles of one flat face count together, so a face is as likely as its share of the squared area.
    together = (normals @ normals.T > 0.999) @ areas
    weights = areas * together
    down = normals[rng.choice(len(normals), p=weights / weights.sum())]
    align, _ = Rotation.align_vectors([[0.0, 0.0, -1.0]], [down])
    return (Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)) * align).as_matrix()

"""Conditions of an experiment: camera, noise, what happens to the cloud on its way, and how worn the hardware is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array, apply, inverse, transform
from dgs_description.hand import HAND
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction
from dgs_learning.evaluation.scene_world import SceneWorld
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.training.views import ViewSettings
from dgs_perception.depth_source import RAW, DepthSource, check_name
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.object_model import GLASS, ObjectModel
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot
from dgs_sim_bridge.world.hand_world import Wear
from dgs_sim_bridge.world.physics import PHYSICS

Cloud = NDArray[np.float32]

HOLE_RADIUS = 0.03
"""As seen by the camera [rad]."""
MISSING = 0.25
"""Share of the points that fall into holes."""
WORN_FRICTION, WORN_MASS = (0.4, 0.9), (0.7, 1.5)
"""Friction of hand and table on an object, and factor on its mass: drawn per object."""
WORN_ZEROS, WORN_BACKLASH, WORN_DELAY, WORN_EFFORT = 0.03, 0.02, 0.04, 0.8
"""Largest error of a joint's zero [rad], play of a joint [rad], delay of the hand [s], torque that is left."""
HAND_EYE_SHIFT, HAND_EYE_TURN = 0.005, float(np.deg2rad(1.0))
"""Largest error of the camera's pose, as it shows in the middle of the workspace [m, rad]."""


def holes(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """Round holes in the image, at random places of it, until `MISSING` of the points are gone."""
    rays = cloud - camera.astype(np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    kept = np.ones(len(cloud), dtype=bool)
    while kept.mean() > 1 - MISSING:
        kept &= rays @ rays[rng.integers(len(rays))] < np.cos(HOLE_RADIUS)
    return cloud[kept]


def no_table(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """No point of the table: a filter in front of the planner has removed it."""
    return cloud[cloud[:, 2] > 0.006]


def wall(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """A rough wall, 0.2 m high, right behind the far edge of what is seen."""
    away = -camera[:2] / np.linalg.norm(camera[:2])
    along = np.array([-away[1], away[0]])
    far = float((cloud[:, :2] @ away).max())
    count = 6000
    place = rng.uniform(-0.4, 0.4, (count, 1)) * along + (far - 0.02 * rng.random((count, 1))) * away
    points = np.column_stack([place, rng.uniform(0.0, 0.2, count)])
    return np.concatenate([cloud, points.astype(np.float32)])


SPOILS: dict[str, Callable[[Cloud, Array, np.random.Generator], Cloud]] = {
    f.__name__: f for f in (holes, no_table, wall)
}
"""Cloud (N, 3), camera (3,), generator -> another cloud, frame *table* [m]."""

_source = cache(DepthSource)  # every process loads its network once


def shot_with_depth_from(
    depth_from: str,
    stage: Stage,
    camera: PinholeCamera,
    T_world_camera: Array,
    noise: D455Noise,
    rng: np.random.Generator,
) -> Shot:
    """A shot whose depth is that of a `DepthSource`; the others as in `dgs_learning.training.views.Sense`."""
    source = _source(depth_from)
    shot = take_shot(stage, camera, T_world_camera, noise, rng, imagers=source.imagers)
    return replace(shot, depth=source(shot.depth, shot.left, shot.right, camera, noise.baseline))


@dataclass(frozen=True)
class Condition:
    """What differs from the views that the network was trained on.

    Attributes:
        noise: factor on the camera's random errors; 0 = a perfect image but for stereo shadows, gaps where a surface is
            seen at a grazing angle, and whole millimetres.
        distance: of the camera, smallest and largest [m].
        elevation: of the camera, smallest and largest [deg].
        spoil: what happens to the cloud on its way to the planner, one of `SPOILS`; empty = nothing.
        table_error: the planner believes the table top so much lower than it is [m].
        friction: of the hand on an object and of the table; None = the engine's.
        edge_filter: flying pixels are set right or taken out, as the camera node does by default.
        worn: worn hardware and things that are heavier and smoother than they look: the depth noise doubles, and every
            scene draws hand-eye error, joint zeros, masses and friction from the ranges above.
        transparent: this share of every scene's objects is glass.
        depth_from: where depth comes from, see `dgs_perception.depth_source`.

    Raises:
        ValueError: there is no such `spoil`, `transparent` is no share, or `table_error` or `friction` is given with
            `worn`, which draws its own.
        DgsError: PARAMETER_INVALID: there is no such source of depth.
    """

    noise: float = 1.0
    distance: tuple[float, float] = ViewSettings.distance
    elevation: tuple[float, float] = (22.5, 75.0)
    spoil: str = ""
    table_error: float = 0.0
    friction: float | None = None
    edge_filter: bool = True
    worn: bool = False
    transparent: float = 0.0
    depth_from: str = RAW

    def __post_init__(self) -> None:
        if self.spoil and self.spoil not in SPOILS:
            raise ValueError(f"no spoil named {self.spoil!r}; there are {', '.join(SPOILS)}")
        if not 0.0 <= self.transparent <= 1.0:
            raise ValueError(f"a share of {self.transparent} transparent objects is not between 0 and 1")
        if self.worn and (self.table_error or self.friction is not None):
            raise ValueError(
                "worn hardware draws its hand-eye error and friction: no table_error or friction beside it"
            )
        check_name(self.depth_from)

    def described(self) -> dict[str, Any]:
        """What makes it another experiment; empty for the views of the training."""
        if self == Condition():
            return {}
        # What a field says by default is left out, so that a new field does not make an old run another experiment.
        plain = asdict(Condition())
        return {"condition": {key: value for key, value in asdict(self).items() if value != plain[key]}}

    def views(self, seen: tuple[float, float]) -> ViewSettings:
        """Camera and its errors; the cloud shows what is within the half extents `seen` in x and y [m]."""
        low, high = np.deg2rad(self.elevation).tolist()
        return ViewSettings(
            self.distance,
            (low, high),
            self._scaled_noise(),
            (*seen, 0.30),
            sense=take_shot if self.depth_from == RAW else partial(shot_with_depth_from, self.depth_from),
            edges=self.edge_filter,
        )

    def _scaled_noise(self) -> D455Noise:
        base = D455Noise()
        random = ("subpixel_rms", "bias_rms", "edge_jitter", "smeared", "dropped")
        factor = self.noise * (2.0 if self.worn else 1.0)
        scaled = {name: getattr(base, name) * factor for name in random}
        return replace(base, **scaled, quantisation=base.quantisation if self.noise else 0.0)

    def world(
        self,
        catalogue: Sequence[ObjectModel],
        scene: Scene,
        engine: str,
        key: Sequence[int],
        edge: float | None = None,
    ) -> SceneWorld:
        """A scene of the catalogue in an engine; hand and objects are as worn, and as many glass, as is said here.

        Args:
            engine: one of `engines.ENGINES`.
            key: of the scene; the same key draws the same wear and the same glass.
            edge: of the table, as in `Setting`.
        """
        models, wear = list(catalogue), None
        glass = round(self.transparent * len(scene.objects))
        for k in np.random.default_rng([*key, 3]).permutation(scene.objects)[:glass]:
            models[k] = replace(models[k], material=GLASS)
        if self.worn:
            rng = np.random.default_rng([*key, 1])
            zeros = rng.uniform(-WORN_ZEROS, WORN_ZEROS, HAND.shape)
            zeros = HAND.expand(HAND.reduce(zeros.reshape(HAND.joint_count)))
            wear = Wear(np.where(HAND.locked, 0.0, zeros), WORN_BACKLASH, WORN_DELAY, WORN_EFFORT)
            for k in scene.objects:
                friction = rng.uniform(*WORN_FRICTION) / PHYSICS.hand_friction
                mass = models[k].mass * rng.uniform(*WORN_MASS)
                models[k] = replace(models[k], friction=friction, mass=mass)
        return SceneWorld(models, scene, engine, self.friction, wear, edge)

    def _hand_eye(self, key: Sequence[int]) -> Array:
        """(4, 4) pose of what the planner takes for the table in the true frame *table*."""
        if not self.worn:
            return transform(position=(0.0, 0.0, -self.table_error))
        rng = np.random.default_rng([*key, 2])
        shift, axis = rng.normal(size=(2, 3))
        shift *= rng.uniform(0.0, HAND_EYE_SHIFT) / np.linalg.norm(shift)
        turn = axis * (rng.uniform(0.0, HAND_EYE_TURN) / np.linalg.norm(axis))
        return transform(Rotation.from_rotvec(turn).as_matrix(), shift)

    def disturb(self, planner: Planner, key: Sequence[int]) -> Planner:
        """The same planner, which gets what the condition leaves of a cloud.

        A table that is believed too low is an error of the cloud alone: grasps stand in the true frame. After a
        hand-eye error the hand goes where the planner says, in the wrong frame.

        Args:
            key: of the scene, as in `world`.
        """
        if not self.spoil and not self.table_error and not self.worn:
            return planner
        T_seen_true = inverse(self._hand_eye(key))
        back = np.eye(4) if self.worn else inverse(T_seen_true)

        def plan(
            cloud: Cloud, camera: ArrayLike, rng: np.random.Generator, request: PlanRequest
        ) -> Prediction:
            place = np.asarray(camera)
            points = SPOILS[self.spoil](cloud, place, rng) if self.spoil else cloud
            seen = apply(T_seen_true, points.astype(float)).astype(np.float32)
            wish = replace(request, failed=request.failed if self.worn else T_seen_true @ request.failed)
            answer = planner(seen, apply(T_seen_true, place), rng, wish)
            return replace(answer, grasps=answer.grasps.moved(back))

        return plan

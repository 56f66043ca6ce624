"""Conditions of an experiment: where the camera stands, how noisy it is, what happens to the cloud on its way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import transform
from dgs_grasp_planner.scene import Planner, PlanRequest, Prediction
from dgs_learning.evaluation.protocol import PlannerFactory
from dgs_learning.training.views import ViewSettings
from dgs_sim_bridge.render.d455 import D455Noise

Array = NDArray[np.float64]
Cloud = NDArray[np.float32]

HOLE_RADIUS = 0.03
"""As seen by the camera [rad]."""
MISSING = 0.25
"""Share of the points that fall into holes."""


def holes(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """Round holes in the image, at random places of it, until `MISSING` of the points are gone."""
    rays = cloud - camera.astype(np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    kept = np.ones(len(cloud), dtype=bool)
    while len(cloud) and kept.mean() > 1 - MISSING:
        kept &= rays @ rays[rng.integers(len(rays))] < np.cos(HOLE_RADIUS)
    return cloud[kept]


def no_table(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """No point of the table: a filter in front of the planner has removed it."""
    return cloud[cloud[:, 2] > 0.006]


def wall(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """A rough wall, 0.2 m high, right behind the far edge of what is seen."""
    away = -camera[:2] / max(float(np.linalg.norm(camera[:2])), 1e-6)
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


@dataclass(frozen=True)
class Condition:
    """What differs from the views that the network was trained on.

    Attributes:
        noise: factor on the camera's random errors; 0 = a perfect image with the stereo shadows.
        distance: of the camera, smallest and largest [m].
        elevation: of the camera, smallest and largest [deg].
        spoil: what happens to the cloud on its way to the planner, one of `SPOILS`; empty = nothing.
        table_error: the planner believes the table top so much lower than it is [m].

    Raises:
        ValueError: there is no such `spoil`.
    """

    noise: float = 1.0
    distance: tuple[float, float] = ViewSettings.distance
    elevation: tuple[float, float] = (22.5, 75.0)
    spoil: str = ""
    table_error: float = 0.0

    def __post_init__(self) -> None:
        if self.spoil and self.spoil not in SPOILS:
            raise ValueError(f"no spoil named {self.spoil!r}; there are {', '.join(SPOILS)}")

    def described(self) -> dict[str, Any]:
        """What makes it another experiment; empty for the views of the training."""
        return {} if self == Condition() else {"condition": asdict(self)}

    def views(self, area: tuple[float, float]) -> ViewSettings:
        """Camera and its errors above a workspace of `area` [m]; the cloud is cut 0.1 m outside of it."""
        low, high = np.deg2rad(self.elevation).tolist()
        crop = (area[0] / 2 + 0.1, area[1] / 2 + 0.1, 0.30)
        return ViewSettings(self.distance, (low, high), self._scaled_noise(), crop)

    def _scaled_noise(self) -> D455Noise:
        base = D455Noise()
        random = ("subpixel_rms", "bias_rms", "edge_jitter", "flying_share")
        scaled = {name: getattr(base, name) * self.noise for name in random}
        return replace(base, **scaled, quantisation=base.quantisation if self.noise else 0.0)

    def disturb(self, factory: PlannerFactory) -> PlannerFactory:
        """The same planners, which get what the condition leaves of a cloud; their grasps stand in the true frame."""
        if not self.spoil and not self.table_error:
            return factory
        up = np.array([0.0, 0.0, self.table_error])

        def disturbed(planner: Planner) -> Planner:
            def plan(
                cloud: Cloud, camera: ArrayLike, rng: np.random.Generator, request: PlanRequest
            ) -> Prediction:
                place = np.asarray(camera)
                points = SPOILS[self.spoil](cloud, place, rng) if self.spoil else cloud
                answer = planner(points + up.astype(np.float32), place + up, rng, request)
                return replace(answer, grasps=answer.grasps.moved(transform(position=-up)))

            return plan

        return lambda truth: disturbed(factory(truth))

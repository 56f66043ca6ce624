"""How the success rate changes with what a simulator does kindly: noise, holes, other views, a wrong table, clutter."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import transform
from dgs_description.grasp import Prediction
from dgs_learning.evaluation.proposers import PlannerChoice, planner_factory
from dgs_learning.evaluation.protocol import Planner, PlannerFactory, Setting, run_scene
from dgs_learning.evaluation.provenance import describe_catalogue, describe_planner, revision
from dgs_learning.evaluation.records import claim, cloud_to_keep, save_scene, scene_file
from dgs_learning.evaluation.run import write_summary
from dgs_learning.training.views import View, ViewSettings
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel

Array = NDArray[np.float64]
Cloud = NDArray[np.float32]
Spoil = Callable[[Cloud, Array, np.random.Generator], Cloud]
"""Cloud (N, 3), camera (3,), generator -> another cloud, frame *table* [m]."""

PATCH = 0.03
"""Radius of a hole as seen by the camera [rad]."""
MISSING = 0.25
"""Share of the points that fall into holes."""


def scaled_noise(factor: float) -> D455Noise:
    """The camera's random errors times `factor`; 0 = a perfect image with the stereo shadows."""
    base = D455Noise()
    if factor == 0:
        return replace(
            base, subpixel_rms=0.0, bias_rms=0.0, quantisation=0.0, edge_jitter=0.0, flying_share=0.0
        )
    return replace(
        base,
        subpixel_rms=base.subpixel_rms * factor,
        bias_rms=base.bias_rms * factor,
        edge_jitter=base.edge_jitter * factor,
        flying_share=min(1.0, base.flying_share * factor),
    )


def with_holes(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """Round holes in the image, at random places of it, until `MISSING` of the points are gone."""
    rays = cloud - camera.astype(np.float32)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    kept = np.ones(len(cloud), dtype=bool)
    while len(cloud) and kept.mean() > 1 - MISSING:
        kept &= rays @ rays[rng.integers(len(rays))] < np.cos(PATCH)
    return cloud[kept]


def without_plane(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """No point of the table: a filter in front of the planner has removed it."""
    return cloud[cloud[:, 2] > 0.006]


def with_background(cloud: Cloud, camera: Array, rng: np.random.Generator) -> Cloud:
    """A rough wall, 0.2 m high, right behind the far edge of what is seen."""
    away = -camera[:2] / max(float(np.linalg.norm(camera[:2])), 1e-6)
    along = np.array([-away[1], away[0]])
    far = float((cloud[:, :2] @ away).max())
    count = 6000
    place = rng.uniform(-0.4, 0.4, (count, 1)) * along + (far - 0.02 * rng.random((count, 1))) * away
    wall = np.column_stack([place, rng.uniform(0.0, 0.2, count)])
    return np.concatenate([cloud, wall.astype(np.float32)])


@dataclass(frozen=True)
class Condition:
    """One row of the table.

    Attributes:
        name: of its folder, text: of its row.
        views: camera and its errors.
        spoil: what happens to the cloud on its way to the planner.
        table_error: the planner believes the table top so much lower than it is [m].
    """

    name: str
    text: str
    views: ViewSettings = field(default_factory=ViewSettings)
    spoil: Spoil | None = None
    table_error: float = 0.0

    def described(self) -> dict[str, Any]:
        """What makes it another experiment."""
        spoil = "" if self.spoil is None else self.spoil.__name__
        return {
            "condition": self.name,
            "views": asdict(self.views),
            "spoil": spoil,
            "table_error": self.table_error,
        }


def _degrees(low: float, high: float) -> tuple[float, float]:
    return float(np.deg2rad(low)), float(np.deg2rad(high))


_VIEW = ViewSettings()
CONDITIONS = (
    Condition("reference", "as in training"),
    Condition("noise_0", "no depth noise", replace(_VIEW, noise=scaled_noise(0.0))),
    Condition("noise_2", "depth noise doubled", replace(_VIEW, noise=scaled_noise(2.0))),
    Condition("holes", f"{MISSING * 100:.0f} % of the depth missing in patches", spoil=with_holes),
    Condition("near", "camera 0.60 to 0.70 m away", replace(_VIEW, distance=(0.60, 0.70))),
    Condition("far", "camera 1.30 to 1.50 m away", replace(_VIEW, distance=(1.30, 1.50))),
    Condition("shallow", "elevation 12 to 20 degrees", replace(_VIEW, elevation=_degrees(12, 20))),
    Condition("steep", "elevation 78 to 88 degrees", replace(_VIEW, elevation=_degrees(78, 88))),
    Condition("table_low", "table believed 5 mm too low", table_error=0.005),
    Condition("table_high", "table believed 5 mm too high", table_error=-0.005),
    Condition("no_plane", "table points removed", spoil=without_plane),
    Condition("background", "rough wall behind the table", spoil=with_background),
)


class Disturbed:
    """A planner that gets what a condition leaves of the cloud."""

    def __init__(self, planner: Planner, condition: Condition):
        self.planner = planner
        self.condition = condition

    def __call__(self, cloud: Cloud, camera_position: Array, rng: np.random.Generator) -> Prediction:
        """The planner's grasps in the true frame *table*."""
        points = cloud if self.condition.spoil is None else self.condition.spoil(cloud, camera_position, rng)
        up = np.array([0.0, 0.0, self.condition.table_error])
        answer = self.planner(points + up.astype(np.float32), np.asarray(camera_position) + up, rng)
        return replace(answer, grasps=answer.grasps.moved(transform(position=-up)))


def run_condition(
    condition: Condition,
    catalogue: Sequence[ObjectModel],
    catalogue_name: str,
    choice: PlannerChoice,
    setting: Setting,
    folder: Path,
) -> dict[str, Any]:
    """Run or finish one condition, scene by scene in this process, and write its summary.

    Args:
        condition: what is different.
        catalogue, catalogue_name: objects to draw scenes from.
        choice: planner.
        setting: scenes, the same for every condition.
        folder: results go here, one file per finished scene.

    Returns:
        the summary.

    Raises:
        ValueError: the folder belongs to another setting.
    """
    objects = describe_catalogue(catalogue_name, catalogue)
    described = {**describe_planner(choice), "objects": objects, **asdict(setting), **condition.described()}
    described = json.loads(json.dumps(described))
    claim(folder, described)
    todo = [n for n in range(setting.scenes) if not scene_file(folder, n).exists()]
    if todo:
        make = planner_factory(choice)
        factory: PlannerFactory = lambda truth: Disturbed(make(truth), condition)  # noqa: E731
        views = replace(condition.views, crop=(setting.area[0] / 2 + 0.1, setting.area[1] / 2 + 0.1, 0.30))
        for number in todo:
            seen: list[Array] = []

            def keep(_: int, view: View, seen: list[Array] = seen) -> None:
                seen.append(cloud_to_keep(view.points))

            save_scene(folder, run_scene(catalogue, factory, setting, number, views, keep), revision(), seen)
    return write_summary(folder, described, setting.scenes)

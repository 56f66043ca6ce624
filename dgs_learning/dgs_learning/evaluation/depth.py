"""The views of an experiment with other depth than the camera's own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array
from dgs_perception.depth_source import DepthSource
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot

_source = cache(DepthSource)


@dataclass(frozen=True)
class SensedBy:
    """A `Sense` of `dgs_learning.training.views`; every process loads its source once.

    Attributes:
        depth_from: see `DepthSource`.
    """

    depth_from: str

    def __call__(
        self,
        stage: Stage,
        camera: PinholeCamera,
        T_world_camera: Array,
        noise: D455Noise,
        rng: np.random.Generator,
    ) -> Shot:
        """A shot whose depth is the source's."""
        source = _source(self.depth_from)
        shot = take_shot(stage, camera, T_world_camera, noise, rng, imagers=source.imagers)
        depth = source(shot.depth, shot.left, shot.right, camera, noise.baseline)
        return replace(shot, depth=depth)

"""The views of an experiment with other depth than the camera's own: from another source, or filtered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dgs_description.camera import PinholeCamera
from dgs_description.frames import Array
from dgs_perception.depth_source import DepthSource
from dgs_perception.edges import EdgeFilter
from dgs_sim_bridge.render.d455 import D455Noise
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot

_source = cache(DepthSource)


@dataclass(frozen=True)
class SensedBy:
    """A `Sense` of `dgs_learning.training.views`; every process loads its source once.

    Attributes:
        depth_from: see `DepthSource`.
        edge_filter: flying pixels are taken out, as the camera node does.
    """

    depth_from: str
    edge_filter: bool = False

    def __call__(
        self,
        stage: Stage,
        camera: PinholeCamera,
        T_world_camera: Array,
        noise: D455Noise,
        rng: np.random.Generator,
    ) -> Shot:
        """A shot whose depth is the source's, filtered."""
        source = _source(self.depth_from)
        shot = take_shot(stage, camera, T_world_camera, noise, rng, imagers=source.imagers)
        depth = source(shot.depth, shot.left, shot.right, camera, noise.baseline)
        if self.edge_filter:
            depth = np.where(EdgeFilter().kept(depth, camera), depth, np.float32(0.0))
        return replace(shot, depth=depth)

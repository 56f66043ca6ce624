"""What the cell's camera sees of a world at one moment: depth, infrared and colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.cell import CELL
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.pictures import Colour, shade
from dgs_sim_bridge.render.raster import Rendering
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot


@dataclass(frozen=True)
class Snapshot:
    """Everything the camera needs, detached from the running simulation.

    Attributes:
        stage: links of the cell first, then the objects, in `base_link`; its `table` is the floor.
        colours: red, green, blue in 0..255 per mesh.
        time: simulated time [s].
    """

    stage: Stage
    colours: tuple[Colour, ...]
    time: float

    def shot(
        self, noise: D455Noise | None = None, rng: np.random.Generator | None = None, imagers: int = 0
    ) -> Shot:
        """As `take_shot`, from the cell's nominal camera pose; `rng`: None = seed 0."""
        rng = np.random.default_rng(0) if rng is None else rng
        T_base_camera = CELL.T_base_camera_optical
        return take_shot(self.stage, D455, T_base_camera, noise, rng, imagers=imagers, normals=True)

    def colour(self, truth: Rendering) -> NDArray[np.uint8]:
        """(H, W, 3) red, green, blue of what a shot shows; its pixels are those of the depth."""
        return shade(truth, self.colours).astype(np.uint8)

"""What the arm carries at its flange, for the robot's own model of its load: mass and centre of gravity. No ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dgs_arm_executor.ik import T_TOOL0_TCP


@dataclass(frozen=True)
class Payload:
    """A load.

    Attributes:
        mass: [kg].
        centre: centre of gravity in `tool0` [m].
    """

    mass: float
    centre: tuple[float, float, float]

    def with_object(self, mass: float, at: ArrayLike = T_TOOL0_TCP[:3, 3]) -> Payload:
        """This load and a point mass [kg] `at` (3,) in `tool0` [m], by default in the TCP."""
        total = self.mass + mass
        if total <= 0:
            return self
        x, y, z = (self.mass * np.asarray(self.centre) + mass * np.asarray(at, float)) / total
        return Payload(total, (float(x), float(y), float(z)))

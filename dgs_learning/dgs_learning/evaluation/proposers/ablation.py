"""Table II's ablations: one of the things that a proposer says is taken away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.scene import Scene


class Ablated:
    """A proposer without its pre-grasp (a fixed open hand instead) or without its offset (zero)."""

    def __init__(self, proposer: Proposer, ablate: str):
        """`ablate`: "pre_grasp" or "offset"."""
        self.proposer, self.ablate = proposer, ablate

    def __call__(self, scene: Scene) -> GraspSet:
        """The proposer's grasps, less what is taken away."""
        grasps = self.proposer(scene)
        if self.ablate == "pre_grasp":
            return replace(grasps, pre_grasp_joints=np.zeros_like(grasps.pre_grasp_joints))
        return replace(grasps, position=grasps.reference_point.copy())

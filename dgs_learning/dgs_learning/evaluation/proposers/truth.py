"""Proposers that know part of the truth: they tell where success is lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.scene import Scene
from dgs_learning.evaluation.proposers.replay import StoredGrasps
from dgs_learning.evaluation.protocol import Truth


class TruePoint(DgsNet):
    """The network asked at true reference points, drawn at random: the voxels next to the TCPs of feasible grasps."""

    def __init__(self, network: DgsNet, stored: StoredGrasps, truth: Truth):
        """The network with its threshold, and the truth of one scene."""
        super().__init__(network.net, network.score_threshold, network.info)
        self.stored, self.truth = stored, truth
        self._draw = np.random.default_rng(0)

    def point_score(self, one: ModuleOneOutput, centres: Array, scene: Scene) -> Array:
        """(V,) random above the threshold at true reference points, 0 elsewhere."""
        grasps = self.stored.feasible(self.truth)
        score = np.zeros(len(centres))
        high = np.flatnonzero(centres[:, 2] > OBJECT_HEIGHT)
        if len(grasps) and len(high):
            rows = high[cKDTree(centres[high]).query(grasps.position)[1]]
            score[rows] = self._draw.uniform(self.score_threshold, 1.0, len(rows))
        return score


@dataclass(frozen=True)
class TrueRest:
    """A feasible stored grasp, the one whose reference point is nearest to the network's best point."""

    network: DgsNet
    stored: StoredGrasps
    truth: Truth

    def __call__(self, scene: Scene) -> GraspSet:
        """One grasp; none where nothing is feasible."""
        best = self.network(scene)
        grasps = self.stored.feasible(self.truth)
        if not len(grasps) or not len(best):
            return GraspSet.empty()
        high = scene.points[scene.points[:, 2] > OBJECT_HEIGHT]
        reference = high[cKDTree(high).query(grasps.position)[1]]
        nearest = np.linalg.norm(reference - best.reference_point[0], axis=1).argmin()
        return grasps[[nearest]]

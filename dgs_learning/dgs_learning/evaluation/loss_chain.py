"""Where success is lost between a stored grasp and an executed one: the network's answers put in one after another.

Replayed grasps -> the network's grasp at a true reference point -> a stored grasp at the network's point -> the
network alone -> its candidates checked -> moved and closed onto the cloud -> ranked by the evidence -> joined by level
pinches: the planner.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from dgs_description.grasp import GraspSet, Prediction
from dgs_grasp_planner.checks import CheckConfig
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.planner import DgsNetPlanner, PlannerConfig
from dgs_grasp_planner.preprocess import CloudSettings
from dgs_learning.evaluation.protocol import Truth
from dgs_learning.evaluation.replay import StoredGrasps

Array = NDArray[np.float64]

STAGES = ("checks", "move", "close", "rank", "propose")
"""What can be left out of the planner."""
NO_CHECKS = CheckConfig(
    table_clearance=-1.0, closed_clearance=-1.0, table_lift=0.0, cloud_points=1 << 30, between_points=0
)


@dataclass(frozen=True)
class Step:
    """One link of the chain: its name, the planner that runs it, what that planner leaves out."""

    name: str
    planner: str
    without: tuple[str, ...] = ()
    text: str = ""


CHAIN = (
    Step("replay", "replay", (), "stored grasps, feasible on the true poses"),
    Step(
        "true_point", "true_point", STAGES, "true reference point, the network's rotation, offset and joints"
    ),
    Step("true_rest", "true_rest", STAGES, "the network's best point, the stored grasp nearest to it"),
    Step("predicted", "dgs_net", STAGES, "everything from the network"),
    Step("checked", "dgs_net", ("move", "close", "rank", "propose"), "and checked against table and cloud"),
    Step("closed", "dgs_net", ("rank", "propose"), "and moved and closed onto the cloud"),
    Step("ranked", "dgs_net", ("propose",), "and ranked by the evidence"),
    Step("proposed", "dgs_net", (), "and level pinches for what lies flat: the planner"),
)


def without(config: PlannerConfig, stages: tuple[str, ...]) -> PlannerConfig:
    """The settings with stages left out.

    Raises:
        ValueError: there is no such stage.
    """
    for stage in stages:
        if stage not in STAGES:
            raise ValueError(f"no stage named {stage!r}; there are {', '.join(STAGES)}")
    kept = config.refine
    refine = replace(
        kept,
        move=kept.move and "move" not in stages,
        close=kept.close and "close" not in stages,
        rank=kept.rank and "rank" not in stages,
        level_pinch=replace(kept.level_pinch, proposals=0) if "propose" in stages else kept.level_pinch,
    )
    return replace(config, refine=refine, checks=NO_CHECKS if "checks" in stages else config.checks)


class TruePointPlanner(DgsNetPlanner):
    """The network asked at true reference points, drawn at random: the voxels next to the TCPs of feasible grasps."""

    def __init__(self, planner: DgsNetPlanner, stored: StoredGrasps, truth: Truth):
        """The network and settings of `planner`, with the truth of one scene."""
        super().__init__(planner.net, planner.config, planner.info)
        self.stored = stored
        self.truth = truth
        self._draw = np.random.default_rng(0)

    def point_score(self, one: ModuleOneOutput, centres: Array) -> Array:
        """(V,) random above the threshold at true reference points, 0 elsewhere."""
        grasps = self.stored.feasible(self.truth)
        score = np.zeros(len(centres))
        high = np.flatnonzero(centres[:, 2] > CloudSettings.object_height)
        if len(grasps) and len(high):
            rows = high[cKDTree(centres[high]).query(grasps.position)[1]]
            score[rows] = self._draw.uniform(self.config.decode.score_threshold, 1.0, len(rows))
        return score


class TrueRestPlanner:
    """A feasible stored grasp, the one whose reference point is nearest to the network's best point."""

    def __init__(self, planner: DgsNetPlanner, stored: StoredGrasps, truth: Truth):
        self.planner = planner
        self.stored = stored
        self.truth = truth

    def __call__(
        self, cloud: NDArray[np.float32], camera_position: ArrayLike, rng: np.random.Generator
    ) -> Prediction:
        """One grasp in the frame *table*; none where nothing is feasible."""
        start = time.perf_counter()
        answer = self.planner(cloud, camera_position, rng)
        grasps = self.stored.feasible(self.truth)
        if not len(grasps) or not len(answer.grasps):
            return replace(answer, grasps=GraspSet.empty())
        high = cloud[cloud[:, 2] > CloudSettings.object_height]
        reference = high[cKDTree(high).query(grasps.position)[1]]
        nearest = np.linalg.norm(reference - answer.grasps.reference_point[0], axis=1).argmin()
        return Prediction(
            grasps.select([nearest]), answer.points_used, {"total": time.perf_counter() - start}
        )

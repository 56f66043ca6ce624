"""The planner: propose, fit the contacts, check, rank. Shared by node, evaluation and command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.propose import Proposer
from dgs_grasp_planner.propose.part import Part
from dgs_grasp_planner.rank import LEAST_SCORE, rank
from dgs_grasp_planner.scene import PlanRequest, Prediction, Scene, prepare

SHIPPED = ("dgs_net", "level_pinch", "edge_pinch", "turn_over", "drag", "push", "part")
"""Proposers of the planner unless others are named: modules of `propose`."""
GRASPING = tuple(name for name in SHIPPED if name != Part.name)
"""Where no table edge is known these propose grasps alone."""
FALLBACK_SCORE = 0.3
"""Score that a proposer's candidates need where none of those that it trusts is left: better than none."""
DOUBTFUL = 0.55
"""Where no grasp has a better score, what can be pushed to where it can be had is pushed first."""
UNPROMISING = 0.1
"""A push with less is of things that touch, to the edge: they are parted first."""
LAST = 0.003
"""A push with less is the last thing to try."""
HOPELESS = 0.4
"""Before grasps with less, things that touch are parted: of such grasps 2 of 12 held, 24 of 39 with up to 0.55."""
STAGES = ("contact", "check", "rank")
"""What follows the proposers; each can be left out by its name."""


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of all stages.

    Raises:
        ValueError: `without` names no stage.
    """

    max_grasps: int = 32
    keep_table: bool = False
    """All of the table's points are looked at, not only those near things."""
    edge: float | None = None
    """The table is where x is larger, frame *table* [m]; None = no edge is known."""
    without: tuple[str, ...] = ()
    """Stages that are left out."""

    def __post_init__(self) -> None:
        for stage in self.without:
            if stage not in STAGES:
                raise ValueError(f"no stage named {stage!r}; there are {', '.join(STAGES)}")


class GraspPlanner:
    """A list of proposers, and the stages that every candidate passes. Not for concurrent calls."""

    def __init__(self, proposers: Sequence[Proposer], settings: PlannerSettings = PlannerSettings()):
        """`proposers`: whose candidates are put together."""
        self.proposers, self.settings = tuple(proposers), settings

    def __call__(
        self,
        cloud: NDArray[np.float32],
        camera_position: ArrayLike,
        rng: np.random.Generator,
        request: PlanRequest = PlanRequest(),
    ) -> Prediction:
        """Grasps for the objects in one cloud; the same cloud and generator give the same answer.

        Args:
            cloud: (N, 3) [m] in the table frame.
            camera_position: (3,) [m] in the table frame.
            rng: decides which points are kept.
            request: wishes of this call.

        Returns:
            In the table frame, best first in every group: likely grasps, pushes, doubtful grasps, pushes that part
            what touches, the remaining grasps; nothing if nothing scored high enough or all were rejected.

        Raises:
            DgsError: CLOUD_FORMAT, CLOUD_EMPTY, CLOUD_NOT_FINITE, CLOUD_NO_TABLE, NO_OBJECTS.
        """
        scene = prepare(cloud, camera_position, rng, request, self.settings.keep_table, self.settings.edge)
        grasps, rejected = self._plan(scene)
        if not grasps.holds.any() and request.min_score is None:
            grasps, rejected = self._plan(scene.asked(FALLBACK_SCORE))
        limit = self.settings.max_grasps if request.max_grasps is None else request.max_grasps
        grasps = grasps[np.argsort(_turn(grasps), kind="stable")]
        wish = scene.request.wanted
        shapes = () if len(grasps) else (s for s in scene.field.shapes.values() if wish(s.tops).any())
        too_wide = tuple(shape.width for shape in shapes if shape.width > HAND.grasp.widest)
        wanted = len(grasps) > 0 or bool(wish(scene.voxels).any())
        return Prediction(grasps[:limit], len(scene.points), scene.clock.finish(), rejected, too_wide, wanted)

    def _plan(self, scene: Scene) -> tuple[GraspSet, dict[str, int]]:
        grasps, rejected = self.candidates(scene)
        if "rank" not in self.settings.without:
            with scene.clock("rank"):
                grasps = rank(grasps, scene.field, scene.request.failed)
                likely = ~grasps.holds | (grasps.score >= LEAST_SCORE)
                grasps, rejected["UNLIKELY"] = grasps[likely], int((~likely).sum())
        return grasps.best_first(), rejected

    def candidates(self, scene: Scene) -> tuple[GraspSet, dict[str, int]]:
        """What is proposed for a scene, fitted and checked, with the proposers' scores; why how many were refused."""
        settings = self.settings
        rejected: dict[str, int] = {}
        proposed = joined([proposer(scene) for proposer in self.proposers])
        shapes = None if scene.request.things is None else scene.field
        grasps = scene.request.admitted(proposed, scene.voxels, shapes)
        if "contact" not in settings.without:
            with scene.clock("contact"):
                grasps = fit(grasps, scene.field)
        if "check" not in settings.without:
            with scene.clock("check"):
                keep_out = scene.request.keep_out
                result = check(grasps, scene.obstacles, scene.edge, fixed=scene.walls, keep_out=keep_out)
                grasps, rejected = result.grasps[result.accepted], result.counts()
        return grasps, rejected


def _turn(grasps: GraspSet) -> NDArray[np.int64]:
    """(K,) whose turn comes first: likely grasps 0, pushes 1, doubtful grasps 2, partings 3, hopeless grasps 4, what is
    tried last 5.
    """
    push, score = ~grasps.holds, grasps.score
    late = (grasps.source == Part.name) | (score < UNPROMISING)
    kinds = [push & (score < LAST), push & late, push, score < HOPELESS, score < DOUBTFUL]
    return np.select(kinds, [5, 3, 1, 4, 2], 0)

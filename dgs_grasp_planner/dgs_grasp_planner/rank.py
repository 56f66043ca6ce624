"""Orders checked grasps: how likely they hold, times the quality of the contacts, times how free the way is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.success import success_model
from dgs_grasp_planner.way import free_way

LEAST_SCORE = 0.2
"""A grasp with less is not worth a try."""


def rank(grasps: GraspSet, field: HeightField | None) -> GraspSet:
    """The grasps with their final scores, best first.

    The fitted probability knows the things it was fitted to; quality and way, set by hand, keep it from being sure of
    what it has not seen. Grasps with a motion keep the proposer's score: a height field cannot judge what goes beneath
    something, or pushes.

    Args:
        grasps: that passed the checks; frame *table*.
        field: what stands there.
    """
    if field is None or not len(grasps):
        return grasps.best_first()
    still = np.flatnonzero(~grasps.motion.any(axis=1))
    score, judged = grasps.score.copy(), grasps[still]
    if len(still):
        score[still] = success_model()(judged, field) * judged.quality * free_way(judged, field)
    return replace(grasps, score=score).best_first()

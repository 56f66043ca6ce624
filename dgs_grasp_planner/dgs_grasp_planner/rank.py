"""Orders checked grasps by how likely they hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.success import success_model

LEAST_SCORE = 0.3
"""What is less likely to hold is not worth a try."""


def rank(grasps: GraspSet, field: HeightField | None) -> GraspSet:
    """The grasps with the probability that they hold for a score, best first.

    Those with a motion keep the proposer's score: a height field cannot judge what goes beneath something, or pushes.

    Args:
        grasps: that passed the checks; frame *table*.
        field: what stands there.
    """
    if field is None or not len(grasps):
        return grasps.best_first()
    still = ~grasps.motion.any(axis=1)
    score = grasps.score.copy()
    score[still] = success_model()(grasps[np.flatnonzero(still)], field) if still.any() else 0.0
    return replace(grasps, score=score).best_first()

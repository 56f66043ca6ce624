"""Orders checked grasps: how likely they hold, times the quality of the contacts, times how free the way is.

What has failed just now scores less, or a robot would try the same again and again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.height_field import HeightField
from dgs_grasp_planner.success import EVIDENCE, evidence, success_model

LEAST_SCORE = 0.3
"""A grasp with less is not worth a try."""

ALIKE, TURNED = 0.03, 0.5
"""Hands nearer to one another than this, turned by less, grasp the same way [m, rad]."""
AGAIN = 0.5
"""So much of its score keeps a grasp for every one like it that failed."""


def rank(grasps: GraspSet, field: HeightField | None, failed: Array) -> GraspSet:
    """The grasps with their final scores, best first.

    The fitted probability knows the things it was fitted to; quality and way, set by hand, keep it from being sure of
    what it has not seen. Grasps with a motion keep the proposer's score: a height field cannot judge what goes beneath
    something, or pushes.

    Args:
        grasps: that passed the checks; frame *table*.
        field: what stands there.
        failed: (F, 4, 4) poses of `hand_tcp` that were tried in vain; frame *table*.
    """
    score = grasps.score.copy()
    still = np.flatnonzero(~grasps.motion.any(axis=1))
    if field is not None and len(still):
        judged = grasps[still]
        values = evidence(judged, field)
        way = values[:, EVIDENCE.index("free_way")]
        score[still] = success_model()(values) * judged.quality * way
    return replace(grasps, score=score * AGAIN ** _alike(grasps, failed)).best_first()


def _alike(grasps: GraspSet, failed: Array) -> Array:
    """(K,) how many of the failed poses (F, 4, 4) are much the same as each grasp."""
    away = np.linalg.norm(grasps.position[:, None] - failed[:, :3, 3], axis=-1)
    cosine = (np.einsum("kij,fij->kf", grasps.rotation, failed[:, :3, :3]) - 1) / 2
    return np.asarray(((away < ALIKE) & (cosine > np.cos(TURNED))).sum(axis=1))

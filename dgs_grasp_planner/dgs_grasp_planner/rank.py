"""Orders checked grasps: how likely they hold, times the quality of the contacts, times how free the way is.

What has failed just now scores less, or a robot would try the same again and again.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.contact.height_field import NEAR, HeightField
from dgs_grasp_planner.success import evidence, success_model
from dgs_grasp_planner.way import free_way

LEAST_SCORE = 0.3
"""A grasp with less is not worth a try."""

ALIKE, TURNED = 0.03, 0.5
"""Hands nearer to one another than this, turned by less, grasp the same way [m, rad]."""
AGAIN = 0.5
"""So much of its score keeps a grasp for every one like it that failed, ..."""
DISTRUST, NEAR_BY = 0.6, 0.08
"""... and for every one that failed on the same thing, near by: what is hard to hold looks easier than it is.

Of tries with a score of 0.55 to 0.7, 339 of 397 held, 26 of 46 where one had failed on the thing before, and 4 of 13
where two had. Pinches over the edge: 150 of 154, 18 of 19 and 5 of 5.
"""


def rank(grasps: GraspSet, field: HeightField, failed: Array) -> GraspSet:
    """The grasps with their final scores, best first.

    The fitted probability knows the things it was fitted to; quality and way, set by hand, keep it from being sure of
    what it has not seen. Grasps with a motion keep the proposer's score: a height field cannot judge what goes beneath
    something, or pushes.

    Args:
        grasps: that passed the checks; frame *table*.
        field: what stands there; of things that touch each is judged alone.
        failed: (F, 4, 4) poses of `hand_tcp` that were tried in vain; frame *table*.
    """
    score = grasps.score.copy()
    still = np.flatnonzero(~grasps.motion.any(axis=1))
    if len(still):
        judged, things = grasps[still], field.separated
        values, way = evidence(judged, things), free_way(judged, things, feared=True)
        score[still] = success_model()(values) * judged.quality * way
        if len(failed):
            score[still] *= DISTRUST ** _same_thing(judged.position, failed[:, :3, 3], things)
    return replace(grasps, score=score * AGAIN ** _alike(grasps, failed)).best_first()


def _alike(grasps: GraspSet, failed: Array) -> Array:
    """(K,) how many of the failed poses (F, 4, 4) are much the same as each grasp."""
    away = np.linalg.norm(grasps.position[:, None] - failed[:, :3, 3], axis=-1)
    cosine = (np.einsum("kij,fij->kf", grasps.rotation, failed[:, :3, :3]) - 1) / 2
    return np.asarray(((away < ALIKE) & (cosine > np.cos(TURNED))).sum(axis=1))


def _same_thing(places: Array, failed: Array, things: HeightField) -> Array:
    """(K,) how many of the places (F, 3) where grasps failed are at the thing at each of (K, 3), and near by [m]."""
    here, there = things.nearest(places, NEAR)[:, None], things.nearest(failed, NEAR)
    near = np.linalg.norm(places[:, None] - failed, axis=-1) < NEAR_BY
    return np.asarray((near & (here == there) & (here > 0)).sum(axis=1))

"""From the network's numbers to candidate grasps: best hypotheses, rotation, joints."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import special

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

_LOWER, _UPPER = HAND.reduce(HAND.lower), HAND.reduce(HAND.upper)
softmax = partial(special.softmax, axis=-1)
SOURCE = "dgs_net"
IDLE = 0.05
"""A finger whose pitch and middle joint both move less than this between J_init and J_end takes no part [rad]."""


def rank_hypotheses(logits: NDArray, count: int) -> tuple[NDArray[np.int64], Array]:
    """The `count` likeliest hypotheses of every row, and their weights.

    A hypothesis weighs its probability relative to the row's likeliest one: a point where many rotations are equally
    good (a ball) is no worse a point than one with a single good rotation.

    Args:
        logits: (S, K).

    Returns:
        (S, count) hypothesis indices, likeliest first; (S, count) weights in (0, 1], the first is 1.
    """
    order = np.argsort(-np.asarray(logits), axis=1, kind="stable")[:, :count]
    probability = np.take_along_axis(softmax(logits), order, axis=1)
    return order, probability / probability[:, :1]


def matrix_from_6d(sixd: NDArray) -> Array:
    """(..., 3, 3) rotations of (..., 6): the first two columns made orthonormal (Zhou et al., 2019)."""
    values = np.asarray(sixd, dtype=np.float64)
    x = values[..., :3] / np.maximum(np.linalg.norm(values[..., :3], axis=-1, keepdims=True), 1e-9)
    y = values[..., 3:] - (x * values[..., 3:]).sum(-1, keepdims=True) * x
    y = y / np.maximum(np.linalg.norm(y, axis=-1, keepdims=True), 1e-9)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def limited_joints(active: NDArray) -> Array:
    """(..., J) joints within the limits of (..., D) active ones [rad], the distal joints coupled."""
    return HAND.expand(np.clip(np.asarray(active, dtype=np.float64), _LOWER, _UPPER))


def grasps_from_outputs(
    reference_point: NDArray,
    score: NDArray,
    rotation6d: NDArray,
    offset: NDArray,
    j_init: NDArray,
    j_end: NDArray,
) -> GraspSet:
    """Grasps of S rows, sorted by score (paper, section IV: T = P + sigma).

    Args:
        reference_point: (S, 3) [m].
        score: (S,) in [0, 1].
        rotation6d: (S, 6).
        offset: (S, 3) [m].
        j_init, j_end: (S, D) active joints [rad], clipped here.
    """
    before, final = limited_joints(j_init), limited_joints(j_end)
    flexion = HAND.split(np.abs(final - before))[..., 1:].max(axis=-1)
    point = np.asarray(reference_point, np.float64)
    return GraspSet.of(
        SOURCE,
        position=point + offset,
        rotation=matrix_from_6d(rotation6d),
        pre_grasp_joints=before,
        grasp_joints=final,
        active_fingers=flexion > IDLE,
        score=score,
        reference_point=point,
    ).best_first()

"""From the network's numbers to candidate grasps: score threshold, spatial NMS, best hypotheses, rotation, joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.grasp import GraspSet
from dgs_description.joints import HAND_LOWER, HAND_UPPER, expand_active, reduce_to_active

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_LOWER, _UPPER = reduce_to_active(HAND_LOWER), reduce_to_active(HAND_UPPER)


@dataclass(frozen=True)
class DecodeConfig:
    """How candidates are chosen."""

    score_threshold: float = 0.7
    """Points below it are no reference points (paper: 0.7)."""
    fallback_threshold: float = 0.3
    """Used only where none of the network's grasps above `score_threshold` passes the checks: better than none."""
    nms_radius: float = 0.025
    """Between reference points [m]."""
    max_points: int = 32
    hypotheses: int = 3
    """Rotations tried per reference point, at most as many as the network has."""


def softmax(logits: NDArray) -> Array:
    """Softmax over the last axis."""
    shifted = np.exp(np.asarray(logits, dtype=np.float64) - np.max(logits, axis=-1, keepdims=True))
    return shifted / shifted.sum(axis=-1, keepdims=True)


def non_maximum_suppression(points: Array, score: Array, radius: float, limit: int) -> Index:
    """Greedy: take the best point, drop all within `radius` of it, repeat.

    Args:
        points: (N, 3) [m].
        score: (N,).
        radius: [m].
        limit: most points to keep.

    Returns:
        (M,) indices, best first. Equal scores are taken in the order of the points.
    """
    order = np.argsort(-score, kind="stable")
    remaining = points[order]
    kept: list[np.int64] = []
    while len(order) and len(kept) < limit:
        kept.append(order[0])
        far = ((remaining - remaining[0]) ** 2).sum(axis=1) > radius * radius
        order, remaining = order[far], remaining[far]
    return np.array(kept, dtype=np.int64)


def reference_rows(centres: Array, score: Array, allowed: NDArray[np.bool_], config: DecodeConfig) -> Index:
    """Rows of the voxels that become reference points.

    Args:
        centres: (V, 3) [m].
        score: (V,) in [0, 1].
        allowed: (V,) False where no grasp is wanted.
        config: threshold, radius, limit.
    """
    rows = np.flatnonzero(allowed & (score > config.score_threshold))
    return rows[non_maximum_suppression(centres[rows], score[rows], config.nms_radius, config.max_points)]


def rank_hypotheses(logits: NDArray, count: int) -> tuple[Index, Array]:
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
    """(..., 20) joints within the limits of (..., 15) active ones [rad], the distal joints coupled."""
    return expand_active(np.clip(np.asarray(active, dtype=np.float64), _LOWER, _UPPER))


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
        score: (S,).
        rotation6d: (S, 6).
        offset: (S, 3) [m].
        j_init, j_end: (S, 15) active joints [rad], clipped here.
    """
    order = np.argsort(-np.asarray(score, dtype=np.float64), kind="stable")
    point, sigma = np.asarray(reference_point, np.float64)[order], np.asarray(offset, np.float64)[order]
    return GraspSet(
        position=point + sigma,
        rotation=matrix_from_6d(np.asarray(rotation6d)[order]),
        pre_grasp_joints=limited_joints(np.asarray(j_init)[order]),
        grasp_joints=limited_joints(np.asarray(j_end)[order]),
        score=np.clip(np.asarray(score, np.float64)[order], 0.0, 1.0),
        reference_point=point,
        offset=sigma,
    )

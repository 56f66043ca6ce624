"""Labels on the voxels of a view: reference and candidate points and their grasps (paper, section V-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.hand_model import JOINTS_PER_FINGER

NOT_GRASPABLE, CANDIDATE, REFERENCE = 0, 1, 2
NEIGHBOURS = 20
"""Candidate points around a reference point (paper)."""
MAX_OFFSET = 0.06
"""A grasp whose TCP is farther from every visible point of its object is not labelled in this view [m]."""
GRASPS_PER_POINT = 4
"""At most so many grasps are kept per point in one view."""
CANDIDATE_WEIGHT = 0.3
"""Of a candidate point's pairs, beside 1 of a reference point's."""
AIR_SHARE = 0.05
"""Of the joints of a finger that closes without meeting anything, beside 1 of one that touches."""


@dataclass(frozen=True)
class Labels:
    """Labels of one cloud of V voxels with P (voxel, grasp) pairs.

    Attributes:
        kind: (V,) int64, NOT_GRASPABLE, CANDIDATE or REFERENCE.
        voxel: (P,) int64 row of each pair.
        worth: (V,) float32 how good a point each voxel is, in [0, 1]; 0 where `kind` says that it is none.
        weight: (P,) float32, 1 for a reference point, less for a candidate and for a grasp that is less steady.
        rotation: (P, 3, 3), offset: (P, 3) [m], j_init, j_end: (P, D) [rad].
        touch: (P, D) float32, what each joint of both counts.
        chosen: (C,) int64 one pair per labelled voxel, drawn at random: what module II is taught.
        grasp: (P,) int64 row of each pair in the grasps that were given.
    """

    kind: NDArray[np.int64]
    worth: NDArray[np.float32]
    voxel: NDArray[np.int64]
    weight: NDArray[np.float32]
    rotation: NDArray[np.float32]
    offset: NDArray[np.float32]
    j_init: NDArray[np.float32]
    j_end: NDArray[np.float32]
    touch: NDArray[np.float32]
    chosen: NDArray[np.int64]
    grasp: NDArray[np.int64]


def label(
    centres: Array,
    instance: NDArray,
    grasps: GraspSet,
    owner: NDArray,
    rng: np.random.Generator,
    paper: bool = False,
    in_air: NDArray[np.bool_] | None = None,
    grasps_per_point: int = GRASPS_PER_POINT,
) -> Labels:
    """Attach grasps to voxels.

    Beyond the paper, candidate points are regressed on as well, with their own offset; steady grasps (their score) are
    learnt rather than others, points are graspable by degrees, and fingers that meet nothing hardly count.

    Args:
        centres: (V, 3) voxel centres in the frame of the grasps [m].
        instance: (V,) object that each voxel belongs to, -1 = table.
        owner: (G,) object that each grasp belongs to.
        rng: decides ties and draws.
        paper: as in the paper: regression on reference points only, all grasps and all points near one are the same.
        in_air: (G, F) fingers of each grasp that close and meet nothing; None = nobody knows.
        grasps_per_point: at most so many are kept per point.
    """
    kind = np.full(len(centres), NOT_GRASPABLE, dtype=np.int64)
    worth = np.zeros(len(centres), dtype=np.float32)
    steady = np.ones(len(grasps)) if paper else grasps.score
    pairs = [(np.empty(0, int), np.empty(0, int), np.empty(0))]  # voxels, grasps, weights
    for k in np.unique(owner):
        rows, mine = np.flatnonzero(instance == k), np.flatnonzero(owner == k)
        tree = cKDTree(centres[rows])
        distance, nearest = tree.query(grasps.position[mine])
        seen = distance < MAX_OFFSET
        mine, nearest = mine[seen], nearest[seen]
        if not len(mine):
            continue
        points, point = np.unique(nearest, return_inverse=True)  # many grasps share a reference point
        _, around = tree.query(centres[rows[points]], k=min(NEIGHBOURS + 1, len(rows)))
        around = around.reshape(len(points), -1)
        kind[rows[around.reshape(-1)]] = np.maximum(kind[rows[around.reshape(-1)]], CANDIDATE)
        kind[rows[points]] = REFERENCE
        worth[rows] = kind[rows] > 0 if paper else _worth(around[point], steady[mine], len(rows))
        pairs.append((rows[nearest], mine, np.ones(len(mine))))
        if not paper:
            near = rows[around[point, 1:]]
            grasp = np.repeat(mine, near.shape[1])
            pairs.append((near.ravel(), grasp, np.full(near.size, CANDIDATE_WEIGHT)))
    voxel, grasp, weight = (np.concatenate(column) for column in zip(*pairs, strict=True))
    keep = _first_few(voxel, weight < 1.0, steady[grasp], grasps_per_point, rng)
    voxel, grasp, weight = voxel[keep], grasp[keep], weight[keep]
    weight = weight * steady[grasp]
    touch = np.ones((len(grasps), len(HAND.driven)))
    if in_air is not None and not paper:
        touch[in_air[:, HAND.driven // JOINTS_PER_FINGER]] = AIR_SHARE
    shuffled = rng.permutation(len(voxel))
    return Labels(
        kind=kind,
        worth=worth,
        voxel=voxel,
        weight=weight.astype(np.float32),
        rotation=grasps.rotation[grasp].astype(np.float32),
        offset=(grasps.position[grasp] - centres[voxel]).astype(np.float32),
        j_init=HAND.reduce(grasps.pre_grasp_joints[grasp]).astype(np.float32),
        j_end=HAND.reduce(grasps.grasp_joints[grasp]).astype(np.float32),
        touch=touch[grasp].astype(np.float32),
        chosen=shuffled[np.unique(voxel[shuffled], return_index=True)[1]],
        grasp=grasp,
    )


def _worth(around: NDArray, steady: Array, count: int) -> Array:
    """(count,) worth of an object's voxels: of the steadiest grasp beside each, less where there are few.

    Args:
        around: (G, N) voxels beside each grasp, the nearest first.
        steady: (G,) how steady each is.
    """
    best, total = np.zeros(count), np.zeros(count)
    np.maximum.at(best, around, steady[:, None])
    np.add.at(total, around, steady[:, None])
    return best * (1.0 - np.exp(-total / np.median(total[total > 0])))


def _first_few(
    voxel: NDArray, candidate: NDArray[np.bool_], steady: Array, count: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Pairs (P,) sorted by voxel, up to `count` of each: those of reference points first, then drawn by steadiness.

    Weighted draws without replacement by one sort: Efraimidis and Spirakis, 2006.
    """
    drawn = np.argsort(-(rng.random(len(voxel)) ** (1.0 / steady)))
    order = drawn[np.argsort(voxel[drawn] * 2 + candidate[drawn], kind="stable")]
    _, start, total = np.unique(voxel[order], return_index=True, return_counts=True)
    rank = np.arange(len(voxel)) - np.repeat(start, total)
    return order[rank < count]


def typical_shapes(grasps: GraspSet, count: int) -> NDArray[np.float32]:
    """(count, 2, D) active joints of pre-grasp and final grasp [rad]: means of as many clusters of the grasps."""
    joints = np.stack([HAND.reduce(grasps.pre_grasp_joints), HAND.reduce(grasps.grasp_joints)], axis=1)
    centres, _ = kmeans2(joints.reshape(len(joints), -1), count, minit="++", rng=np.random.default_rng(0))
    return centres.reshape(count, 2, -1).astype(np.float32)

"""Labels on the voxels of a view.

Reference points, candidate points, and the grasps that belong to them (paper, section V-B).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dgs_description.grasp import GraspSet
from dgs_description.joints import reduce_to_active

Array = NDArray[np.float64]

NOT_GRASPABLE, CANDIDATE, REFERENCE, UNKNOWN = 0, 1, 2, 3
"""UNKNOWN.

A point of an object for which no feasible grasp was found, which does not prove that there is none.
"""


@dataclass(frozen=True)
class LabelSettings:
    """How grasps attach to points."""

    neighbours: int = 20
    """Candidate points around a reference point (paper)."""
    max_offset: float = 0.06
    """A grasp whose TCP is farther from every visible point of its object is not labelled in this view [m]."""
    supervise_candidates: bool = True
    """Regress on candidate points as well, with their own offset; the paper regresses on reference points
    only."""
    unknown_objects: bool = True
    """Mark objects without a labelled grasp as unknown instead of not graspable (paper)."""
    grasps_per_point: int = 4
    """At most so many grasps are kept per point in one view."""


@dataclass(frozen=True)
class Labels:
    """Labels of one cloud of V voxels with P (voxel, grasp) pairs.

    Attributes:
        kind: (V,) int64, NOT_GRASPABLE, CANDIDATE, REFERENCE or UNKNOWN.
        voxel: (P,) int64 row of each pair.
        weight: (P,) float32, 1 for a reference point, less for a candidate.
        rotation: (P, 3, 3), offset: (P, 3) [m], j_init, j_end: (P, 15) [rad].
        chosen: (C,) int64 one pair per labelled voxel, drawn at random: what module II is taught.
        grasp: (P,) int64 row of each pair in the grasps that were given.
    """

    kind: NDArray[np.int64]
    voxel: NDArray[np.int64]
    weight: NDArray[np.float32]
    rotation: NDArray[np.float32]
    offset: NDArray[np.float32]
    j_init: NDArray[np.float32]
    j_end: NDArray[np.float32]
    chosen: NDArray[np.int64]
    grasp: NDArray[np.int64]


CANDIDATE_WEIGHT = 0.3


def label(
    centres: Array,
    instance: NDArray,
    grasps: GraspSet,
    owner: NDArray,
    rng: np.random.Generator,
    settings: LabelSettings,
) -> Labels:
    """Attach grasps to voxels.

    Args:
        centres: (V, 3) voxel centres in the frame of the grasps [m].
        instance: (V,) object that each voxel belongs to, -1 = table.
        grasps: feasible grasps of the scene.
        owner: (G,) object that each grasp belongs to.
        rng: decides ties and draws.
    """
    kind = np.full(len(centres), NOT_GRASPABLE, dtype=np.int64)
    pairs: list[tuple[Array, Array, Array]] = []
    for k in np.unique(owner):
        rows, mine = np.flatnonzero(instance == k), np.flatnonzero(owner == k)
        if not len(rows):
            continue
        tree = cKDTree(centres[rows])
        distance, nearest = tree.query(grasps.position[mine])
        seen = distance < settings.max_offset
        mine, nearest = mine[seen], nearest[seen]
        if not len(mine):
            continue
        points, point = np.unique(nearest, return_inverse=True)  # many grasps share a reference point
        _, around = tree.query(centres[rows[points]], k=min(settings.neighbours + 1, len(rows)))
        around = around.reshape(len(points), -1)
        kind[rows[around.reshape(-1)]] = np.maximum(kind[rows[around.reshape(-1)]], CANDIDATE)
        kind[rows[points]] = REFERENCE
        pairs.append((rows[nearest], mine, np.ones(len(mine))))
        if settings.supervise_candidates:
            near = around[point, 1:]
            pairs.append(
                (rows[near.reshape(-1)], np.repeat(mine, near.shape[1]), np.full(near.size, CANDIDATE_WEIGHT))
            )
    if settings.unknown_objects:
        labelled = np.unique(instance[kind > 0])
        kind[(instance >= 0) & ~np.isin(instance, labelled)] = UNKNOWN
    return _pack(centres, kind, pairs, grasps, rng, settings)


def _pack(
    centres: Array,
    kind: NDArray[np.int64],
    pairs: list[tuple[Array, Array, Array]],
    grasps: GraspSet,
    rng: np.random.Generator,
    settings: LabelSettings,
) -> Labels:
    voxel, grasp, weight = (
        (np.concatenate(column) for column in zip(*pairs, strict=True)) if pairs else (np.empty(0, int),) * 3
    )
    # Reference pairs first, the rest in random order; then the first few of every voxel are kept.
    shuffled = rng.permutation(len(voxel))
    key = voxel[shuffled].astype(int) * 2 + (weight[shuffled] < 1.0)
    order = shuffled[np.argsort(key, kind="stable")]
    voxel, grasp, weight = voxel[order].astype(int), grasp[order].astype(int), weight[order]
    start = np.flatnonzero(np.diff(voxel, prepend=-1)) if len(voxel) else np.empty(0, int)
    rank = np.arange(len(voxel)) - np.repeat(start, np.diff(np.append(start, len(voxel))))
    keep = rank < settings.grasps_per_point
    voxel, grasp, weight = voxel[keep], grasp[keep], weight[keep]
    shuffled = rng.permutation(len(voxel))
    _, first = np.unique(voxel[shuffled], return_index=True)
    return Labels(
        kind=kind,
        voxel=voxel,
        weight=weight.astype(np.float32),
        rotation=grasps.rotation[grasp].astype(np.float32),
        offset=(grasps.position[grasp] - centres[voxel]).astype(np.float32),
        j_init=reduce_to_active(grasps.pre_grasp_joints[grasp]).astype(np.float32),
        j_end=reduce_to_active(grasps.grasp_joints[grasp]).astype(np.float32),
        chosen=shuffled[first],
        grasp=grasp,
    )

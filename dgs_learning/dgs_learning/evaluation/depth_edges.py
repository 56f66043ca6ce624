"""What a depth camera does at the edges of things: real depth images beside rendered ones, by the same measure.

Only edges along rows count whose near side lies left: there a camera whose left imager gives the depth casts no shadow.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_learning.dataset import GraspDataset
from dgs_learning.training.views import ViewSettings, camera_pose, table_mesh
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.shot import Stage, take_shot

FLAT, RUN = 0.8, 5
"""A side of an edge is so many pixels within so much disparity."""
LEAST_STEP = 4.0
"""Of an edge that counts. Disparities are those that the D455's imagers would have at the image's focal length [px]."""
FARTHEST = 0.05
"""From one side to the other, at most [rad]."""


@dataclass(frozen=True)
class Edges:
    """Places where an image steps back from one pixel to a later one of its row.

    Attributes:
        between: (N,) what is measured between 10 and 90 % of the step [rad].
        gap: (N,) what has no depth [rad].
        wander: (M,) second difference of an edge's place over three rows [rad], where it has no gap.
    """

    between: Array
    gap: Array
    wander: Array


def find_edges(depth: NDArray, focal: float) -> Edges:
    """Edges of a depth image (H, W) [m], 0 = none, of a camera with focal length `focal` [px]."""
    disparity = np.divide(
        focal * D455Noise.baseline, depth, out=np.full(depth.shape, np.nan), where=depth > 0
    )
    flat = np.ptp(np.lib.stride_tricks.sliding_window_view(disparity, RUN, axis=1), axis=2) < FLAT
    width = disparity.shape[1]
    ends = np.zeros(depth.shape, bool)
    ends[:, RUN - 1 :] = flat
    ends[:, :-1] &= ~(np.abs(np.diff(disparity, axis=1)) < FLAT / 2)
    starts = np.where(np.pad(flat, ((0, 0), (0, RUN - 1))), np.arange(width), 2 * width)
    following = np.minimum.accumulate(starts[:, ::-1], axis=1)[:, ::-1]
    between, gaps, places = [], [], []
    for v, u in np.argwhere(ends[:, : width - RUN]):
        far = following[v, u + 1]
        if far - u > FARTHEST * focal:
            continue
        near_side = np.median(disparity[v, u + 1 - RUN : u + 1])
        step = near_side - np.median(disparity[v, far : far + RUN])
        if step < LEAST_STEP:
            continue
        share = (near_side - disparity[v, u + 1 : far]) / step
        gap = int(np.isnan(share).sum())
        between.append(int(((share > 0.1) & (share < 0.9)).sum()))
        gaps.append(gap)
        if not gap:
            places.append((v, u + 1 + int((share < 0.5).sum())))
    scale = 1.0 / focal
    return Edges(scale * np.array(between, float), scale * np.array(gaps, float), scale * _wander(places))


def _wander(places: list[tuple[int, int]]) -> Array:
    """Second differences of columns over three rows; `places` are rows and columns."""
    rows: dict[int, list[int]] = {}
    for v, u in places:
        rows.setdefault(v, []).append(u)
    found = []
    for v, columns in rows.items():
        for u in columns:
            one = [w for w in rows.get(v + 1, []) if abs(w - u) <= 5]
            two = [w for w in rows.get(v + 2, []) if abs(w - u) <= 7]
            if len(one) == len(two) == 1:
                found.append(u - 2 * one[0] + two[0])
    return np.array(found, float)


def summarise(frames: Iterable[Edges]) -> dict[str, float]:
    """Shares and widths over all edges of some images, which have some without a gap; angles in mrad."""
    frames = list(frames)
    between, gap, wander = (
        1000.0 * np.concatenate([getattr(frame, name) for frame in frames])
        for name in ("between", "gap", "wander")
    )
    whole = between[gap == 0]
    return {
        "frames": len(frames),
        "edges": len(between),
        "with_gap": float((gap > 0).mean()),
        "between_mean_mrad": float(whole.mean()),
        "between_p75_mrad": float(np.percentile(whole, 75)),
        "between_p90_mrad": float(np.percentile(whole, 90)),
        "wander_mrad": float(np.sqrt((wander**2).mean() / 6.0)),
    }


def rendered(dataset: GraspDataset, number: int, noise: D455Noise) -> NDArray[np.float32]:
    """Depth image (H, W) [m] of the dataset's scene `number` by the D455 with some noise."""
    rng = np.random.default_rng(number)
    scene = dataset.scenes[number % len(dataset.scenes)]
    meshes = [dataset.objects[k].mesh for k in scene.objects]
    stage = Stage(meshes, scene.T_table_object, table=table_mesh(None))
    return take_shot(stage, D455, camera_pose(rng, ViewSettings()), noise, rng).depth

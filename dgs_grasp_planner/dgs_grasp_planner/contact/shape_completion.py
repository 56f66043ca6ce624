"""The shapes of things that one view shows in part, completed by a small network that has seen many from all sides.

It looks down on the height field and says of every cell whether something stands there, how high, and where the middle
of its thing is. Taken from it is what the camera could not see, and what belongs together; what was seen stays as it
was, for the ranking was fitted to that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label
from scipy.special import expit

from dgs_description.errors import ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array
from dgs_description.paths import models_dir
from dgs_grasp_planner.contact.things import CELL, told_apart

if TYPE_CHECKING:
    from dgs_description.unet import UNet

Floats = NDArray[np.float32]
Numbers = NDArray[np.int32]

NAME = "shape_completion"
"""Of the weights in the models folder."""
NOTHING = -1.0
"""Height where nothing stands [m]."""
WIDTHS = (48, 80, 128, 176, 208)
"""Channels per level of the network."""
INPUTS, OUTPUTS = 9, 5
"""Channels: see `Seen` and `Answer`; the last output, where another thing is beside, only helps to learn."""
SCALE = 10.0
"""Of heights, so that things on a table are of the order of one."""
SHADOW = 0.12
"""How far in front of a place something may stand that hides it [m]."""
REACH = 0.08
"""So far around what is seen of things there may be more of them [m]."""
BELIEVED, FEARED = 0.5, 0.1
"""Probability from which on something is taken to stand there, and from which on a hand had better go elsewhere."""


@dataclass(frozen=True)
class Seen:
    """What a camera makes of a height field.

    Attributes:
        features: (9, X, Y) float32 for the network: height and whether anything is seen; height of the shadow;
            direction (2) to the camera, and its elevation above the horizon in quarters of a turn; highest and lowest
            point of the cell, gaps between points not closed; whether the table is seen.
        shadow: (X, Y) height below which a cell is hidden by what stands in front of it [m]; <= 0 where nothing is.
    """

    features: Floats
    shadow: Floats


@dataclass(frozen=True)
class Answer:
    """What the network says of every cell.

    Attributes:
        chance: (X, Y) probability that something stands there.
        height: (X, Y) its height, if so [m].
        way: (2, X, Y) to the middle of its thing's cells, if so [m].
    """

    chance: Floats
    height: Floats
    way: Floats


def seen(heights: Floats, high: Floats, table: Floats, camera: Array, low: Array) -> Seen:
    """Features of a height field.

    Args:
        heights: (X, Y) highest seen point of every cell, gaps closed, `NOTHING` where there is none [m].
        high, table: (N, 3), (M, 3) the points of things and of the table around them [m].
        camera: (3,) position [m].
        low: (2,) corner of cell (0, 0) [m].
    """
    eye = (camera[:2] - low) / CELL
    x, y = (np.arange(n, dtype=np.float32) + np.float32(0.5) for n in heights.shape)
    dx, dy = np.broadcast_arrays((np.float32(eye[0]) - x)[:, None], (np.float32(eye[1]) - y)[None])
    distance = np.maximum(np.hypot(dx, dy), np.float32(1e-3))
    dx, dy, slope = dx / distance, dy / distance, np.float32(camera[2] / CELL) / distance
    shadow = _shadow(heights, dx, dy, slope)
    stands = heights > 0
    highest, lowest, bare = (np.full(heights.shape, value, np.float32) for value in (0.0, np.inf, 0.0))
    (cells, z), (empty, _) = (on_grid(points, heights.shape, low) for points in (high, table))
    np.maximum.at(highest, cells, z)
    np.minimum.at(lowest, cells, z)
    bare[empty] = 1.0
    features = [
        np.where(stands, heights, 0) * SCALE,
        stands,
        np.clip(shadow, 0, None) * SCALE,
        dx,
        dy,
        np.arctan(slope) / (np.pi / 2),
        highest * SCALE,
        np.where(np.isfinite(lowest), lowest, 0) * SCALE,
        bare,
    ]
    return Seen(np.stack(features).astype(np.float32), shadow)


def on_grid(points: Floats, size: tuple[int, ...], low: Array) -> tuple[tuple[NDArray, NDArray], Floats]:
    """Cells of those points (N, 3) that lie within the grid of this size, and their heights [m]."""
    cells = np.floor((points[:, :2] - low) / CELL).astype(np.int64)
    inside = ((cells >= 0) & (cells < size)).all(axis=1)
    x, y = cells[inside].T
    return (x, y), points[inside, 2].astype(np.float32)


def _shadow(heights: Floats, dx: Floats, dy: Floats, slope: Floats) -> Floats:
    """(X, Y) as in `Seen`; direction (dx, dy) to the camera and tangent of its elevation per cell (X, Y)."""
    width, depth = heights.shape
    x, y = np.ogrid[:width, :depth]
    out = np.full(heights.shape, NOTHING, dtype=np.float32)
    for back in np.arange(2, SHADOW / CELL, 3, dtype=np.float32):
        i = np.clip(x + np.float32(0.5) + back * dx, 0, width - 1).astype(np.int32)
        j = np.clip(y + np.float32(0.5) + back * dy, 0, depth - 1).astype(np.int32)
        np.maximum(out, heights.take(i * depth + j) - back * np.float32(CELL) * slope, out=out)
    return out


def complete(
    heights: Floats, owner: Numbers, high: Floats, table: Floats, camera: Array, low: Array
) -> tuple[Floats, Floats, Numbers, Numbers]:
    """Completes what is seen; arguments as for `seen`, `owner` (X, Y) the connected shapes, 0 = none.

    Returns:
        (X, Y) heights, and heights of all that may be there [m]; connected shapes and things, as in `HeightField`.

    Raises:
        DgsError: as `shape_completion`.
    """
    if not owner.any():
        return heights, heights, owner, owner
    view = seen(heights, high, table, camera, low)
    said = answer(shape_completion(), view.features)
    height = np.minimum(said.height, view.shadow)
    higher = height > np.maximum(heights, OBJECT_HEIGHT)
    made = _joined((said.chance > BELIEVED) & higher, owner)
    perhaps = _joined((said.chance > FEARED) & higher, owner)
    nearest = distance_transform_edt(owner == 0, return_distances=False, return_indices=True)
    shapes = np.where(made, owner[tuple(nearest)], owner)
    whole, feared = (np.where(more, height, heights) for more in (made, perhaps))
    return whole, feared, shapes, told_apart(shapes, said.way)


def _joined(fill: NDArray[np.bool_], owner: Numbers) -> NDArray[np.bool_]:
    """What of `fill` (X, Y) is joined to what is owned."""
    shapes, count = label(fill | (owner > 0), structure=np.ones((3, 3)))
    touches = np.zeros(count + 1, bool)
    touches[shapes[owner > 0]] = True
    return fill & touches[shapes]


def completion_net() -> UNet:
    """Inputs as in `Seen`; outputs: logit that something stands there, its height times `SCALE`, the way (2) to the
    middle of its thing [0.1 m], logit that another thing is within two cells."""
    from dgs_description.unet import UNet

    return UNet(INPUTS, OUTPUTS, WIDTHS)


def answer(net: UNet, features: Floats) -> Answer:
    """What the network makes of features (9, X, Y)."""
    import torch

    size = features.shape[1:]
    coarsest = 2 ** len(WIDTHS)
    whole = np.pad(features, ((0, 0), *((0, -n % coarsest) for n in size)))
    with torch.inference_mode():
        said = net(torch.from_numpy(whole)[None])[0, :, : size[0], : size[1]].numpy()
    return Answer(expit(said[0]), said[1] / SCALE, said[2:4] / SCALE)


def loaded_net(weights: Path) -> UNet:
    """The network with its weights. Raises DgsError WEIGHTS_MISSING; WEIGHTS_ALTERED: the file holds something else."""
    code = ErrorCode.WEIGHTS_ALTERED if weights.exists() else ErrorCode.WEIGHTS_MISSING
    return completion_net().loaded(weights, code, "dgs train-shape-completion")


@cache
def shape_completion() -> UNet:
    """The network that ships, loaded once; raises as `loaded_net`."""
    return loaded_net(models_dir() / f"{NAME}.pt")

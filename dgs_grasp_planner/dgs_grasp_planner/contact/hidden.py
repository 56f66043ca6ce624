"""The sides of things that the camera cannot see, guessed by a small network that has seen many things from all sides.

It looks down on the height field and says, in the shadows of things, where something stands and how high. Nothing that
the camera saw is lowered.
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
from dgs_grasp_planner.contact.things import CELL

if TYPE_CHECKING:
    from dgs_description.unet import UNet

Floats = NDArray[np.float32]

NAME = "hidden_sides"
"""Of the weights in the models folder."""
NOTHING = -1.0
"""Height where nothing stands [m]."""
WIDTHS = (16, 24, 40, 56)
"""Channels per level of the network."""
SCALE = 10.0
"""Of heights, so that things on a table are of the order of one."""
SHADOW = 0.12
"""How far in front of a place something may stand that hides it [m]."""
REACH = 0.08
"""Hidden sides are no farther than this from what is seen of a thing [m]."""
BELIEVED, FEARED = 0.5, 0.2
"""Probability from which on something is taken to stand there, and from which on a hand had better go elsewhere."""


@dataclass(frozen=True)
class Seen:
    """What a camera makes of a height field.

    Attributes:
        features: (6, X, Y) float32 for the network: height and whether anything is seen; height of the shadow;
            direction (2) to the camera, and its elevation above the horizon in quarters of a turn.
        shadow: (X, Y) height below which a cell is hidden by what stands in front of it [m]; <= 0 where nothing is.
    """

    features: Floats
    shadow: Floats


def seen(heights: Floats, camera: Array, low: Array) -> Seen:
    """Features of a height field.

    Args:
        heights: (X, Y) highest seen point of every cell, `NOTHING` where there is none [m].
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
    features = [
        np.where(stands, heights, 0) * SCALE,
        stands,
        np.clip(shadow, 0, None) * SCALE,
        dx,
        dy,
        np.arctan(slope) / (np.pi / 2),
    ]
    return Seen(np.stack(features).astype(np.float32), shadow)


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


class HiddenSides:
    """The network with its weights."""

    def __init__(self, file: Path | None = None) -> None:
        """Load the weights; None = those in the models folder.

        Raises:
            DgsError: WEIGHTS_MISSING; WEIGHTS_ALTERED: the file holds something else.
        """
        weights = file or models_dir() / f"{NAME}.pt"
        code = ErrorCode.WEIGHTS_ALTERED if weights.exists() else ErrorCode.WEIGHTS_MISSING
        self.net = hidden_net().loaded(weights, code, "dgs train-hidden-sides")

    def __call__(self, heights: Floats, owner: NDArray[np.int32], camera: Array, low: Array) -> Floats:
        """Fill the hidden sides of all things, in place.

        Args:
            heights, camera, low: as for `seen`.
            owner: (X, Y) number of the shape that covers a cell, 0 = none.

        Returns:
            (X, Y) heights with all that is feared to stand there [m].
        """
        if not owner.any():
            return heights
        view = seen(heights, camera, low)
        chance, height = answer(self.net, view.features)
        height = np.minimum(height, view.shadow)
        away, nearest = distance_transform_edt(owner == 0, return_indices=True)
        higher = (height > np.maximum(heights, OBJECT_HEIGHT)) & (away * CELL < REACH)
        fear = _joined((chance > FEARED) & higher, owner)
        feared = np.where(fear, height, heights)
        fill = _joined((chance > BELIEVED) & higher, owner)
        heights[fill] = height[fill]
        owner[fill] = owner[tuple(nearest)][fill]
        return feared


def _joined(fill: NDArray[np.bool_], owner: NDArray[np.int32]) -> NDArray[np.bool_]:
    """What of `fill` (X, Y) is joined to what is seen."""
    shapes, count = label(fill | (owner > 0), structure=np.ones((3, 3)))
    touches = np.zeros(count + 1, bool)
    touches[shapes[owner > 0]] = True
    return fill & touches[shapes]


def hidden_net() -> UNet:
    """Inputs as in `Seen`; outputs: logit that something unseen stands there, its height times `SCALE`."""
    from dgs_description.unet import UNet

    return UNet(6, 2, WIDTHS)


def answer(net: UNet, features: Floats) -> tuple[Floats, Floats]:
    """Chance that something unseen stands in a cell (X, Y), and how high [m], for features (6, X, Y)."""
    import torch

    size = features.shape[1:]
    even = np.pad(features, ((0, 0), *((0, n % 2) for n in size)))
    with torch.inference_mode():
        logit, height = net(torch.from_numpy(even)[None])[0, :, : size[0], : size[1]].numpy()
    return expit(logit), height / SCALE


@cache
def hidden_sides() -> HiddenSides:
    """The network that ships, loaded once. Raises DgsError WEIGHTS_MISSING, WEIGHTS_ALTERED."""
    return HiddenSides()

"""Trains the network of hidden sides (`dgs_grasp_planner.contact.hidden`) on rendered views of the dataset's scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import trange

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array, transform
from dgs_description.unet import UNet
from dgs_grasp_planner.contact.height_field import seen_heights
from dgs_grasp_planner.contact.hidden import BELIEVED, NAME, REACH, SCALE, answer, hidden_net, seen
from dgs_grasp_planner.contact.things import CELL
from dgs_learning.dataset import GraspDataset
from dgs_learning.training.fit_unet import FitSettings, Values, fit, kept, ship
from dgs_learning.training.views import ViewSettings, ViewSource
from dgs_sim_bridge.render.raster import Mesh, render

VIEWS = replace(ViewSettings(), distance=(0.4, 1.4), elevation=(0.17, 1.5))
"""From nearly all around, as near as from the wrist."""
CROP = 112
"""Side of the squares that a step sees, around something hidden [cells]."""
TOLERANCE = 0.005
"""Something unseen stands where it is so much higher than what is seen; twice that is forgiven above a shadow [m]."""
FAR = 50.0
"""Height of the camera that looks at the truth: columns stand upright in its picture within 0.5 % [m]."""
SETTINGS = FitSettings(views=4000, held_out=100, steps=12000, batch=12)
"""Views are of the scenes in turn; those held out have scenes of their own."""


@dataclass(frozen=True)
class Sample:
    """One view.

    Attributes:
        features: (6, X, Y) float16, as the network sees it.
        truth: (2, X, Y) float16: 1 where something unseen stands, 0 where not, NaN where nothing is hidden; its height
            times `SCALE`.
    """

    features: NDArray[np.float16]
    truth: NDArray[np.float16]


def scene_and_turn(dataset: GraspDataset, number: int, settings: FitSettings) -> tuple[int, int]:
    """Which scene view `number` shows, and the how manyth of its views it is: the last views have their own scenes."""
    rest = len(dataset.scenes) - settings.held_out
    if number >= settings.views - settings.held_out:
        return rest + number - settings.views + settings.held_out, 0
    turn, scene = divmod(number, rest)
    return scene, turn


def render_sample(dataset: GraspDataset, scene: int, turn: int, seed: int) -> Sample | None:
    """View `turn` of a scene of the dataset; None where nothing but the table is seen."""
    stored = dataset.scenes[scene]
    try:
        view = ViewSource(dataset, seed, VIEWS).view(scene, turn)
    except DgsError:  # from so near and so flat it looks past everything
        return None
    found = seen_heights(view.points, REACH)
    if found is None:
        return None
    heights, _, low = found
    what = seen(heights, view.camera, low)
    meshes: list[Mesh] = [dataset.objects[k].mesh for k in stored.objects]
    true = true_heights(meshes, stored.T_table_object, heights.shape, low)
    hidden = what.shadow > np.maximum(heights, OBJECT_HEIGHT)
    stands = (true > np.maximum(heights, OBJECT_HEIGHT) + TOLERANCE) & (true < what.shadow + 2 * TOLERANCE)
    truth = np.stack([np.where(hidden, stands, np.nan), np.where(stands, true, 0.0) * SCALE])
    return Sample(what.features.astype(np.float16), truth.astype(np.float16))


def true_heights(
    meshes: Sequence[Mesh], poses: Sequence[Array] | Array, size: tuple[int, ...], low: Array
) -> NDArray[np.float32]:
    """(X, Y) highest point of meshes in every cell [m], 0 where there is none; frame *table*.

    Args:
        poses: (4, 4) of each mesh.
        size: X, Y; low: (2,) corner of cell (0, 0) [m].
    """
    width, height = size
    focal = FAR / CELL
    camera = PinholeCamera(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5)
    middle = low + np.array(size) * CELL / 2
    down = transform(np.diag([1.0, -1.0, -1.0]), (*middle, FAR))
    depth = render(meshes, poses, camera, down).depth
    return np.where(depth > 0, FAR - depth, 0.0)[::-1].T.astype(np.float32)


def sample(dataset: GraspDataset, number: int, settings: FitSettings, cache: Path) -> Sample:
    """View `number`, kept in a folder; empty where nothing is seen."""
    scene, turn = scene_and_turn(dataset, number, settings)

    def make() -> dict[str, NDArray]:
        made = render_sample(dataset, scene, turn, settings.seed)
        return vars(made or Sample(np.zeros((6, 0, 0), np.float16), np.zeros((2, 0, 0), np.float16)))

    return Sample(**kept(cache / f"seed{settings.seed}_scene{scene:05d}_view{turn:02d}.npz", make))


def crops(samples: Sequence[Sample], settings: FitSettings, step: int) -> tuple[NDArray, NDArray]:
    """The batch of a step: features (N, 6, CROP, CROP) and truth (N, 2, CROP, CROP), turned and mirrored."""
    rng = np.random.default_rng([settings.seed, 107, step])
    rows = [_crop(samples[int(rng.integers(len(samples)))], rng) for _ in range(settings.batch)]
    features, truth = (np.stack(part).astype(np.float32) for part in zip(*rows, strict=True))
    return features, truth


def _crop(one: Sample, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    wide = ((0, 0), (CROP // 2, CROP // 2), (CROP // 2, CROP // 2))
    features = np.pad(one.features, wide)
    truth = np.pad(one.truth, wide, constant_values=np.nan)
    places = np.argwhere(np.isfinite(one.truth[0]))
    x, y = places[int(rng.integers(len(places)))]
    features, truth = features[:, x : x + CROP, y : y + CROP], truth[:, x : x + CROP, y : y + CROP]
    features = features.copy()
    for axis in (1, 2):
        if rng.random() < 0.5:
            features, truth = np.flip(features, axis).copy(), np.flip(truth, axis)
            features[2 + axis] *= -1  # the direction to the camera
    if rng.random() < 0.5:
        features, truth = features.transpose(0, 2, 1)[[0, 1, 2, 4, 3, 5]], truth.transpose(0, 2, 1)
    return features, truth


def loss_terms(out: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Cross entropy where something is hidden, and mean error of the heights where something stands.

    Args:
        out: (N, 2, h, w) of the network; truth: (N, 2, h, w) of the samples.
    """
    hidden, stands = torch.isfinite(truth[:, 0]), truth[:, 0].nan_to_num()
    entropy = binary_cross_entropy_with_logits(out[:, 0], stands, weight=hidden.float(), reduction="sum")
    error = ((out[:, 1] - truth[:, 1].nan_to_num()).abs() * stands).sum()
    return entropy / hidden.sum().clamp(1), error / stands.sum().clamp(1.0)


def measure(net: UNet, samples: Sequence[Sample]) -> Values:
    """Of whole views: what is hidden and found, how much of what is found is there, and the error of its height."""
    found_, there, both = 0, 0, 0
    errors = []
    for one in samples:
        if not one.truth.size:
            continue
        chance, height = answer(net, one.features.astype(np.float32))
        hidden, stands = np.isfinite(one.truth[0]), one.truth[0] == 1
        found = hidden & (chance > BELIEVED)
        found_, there, both = found_ + found.sum(), there + stands.sum(), both + (found & stands).sum()
        errors.append(np.abs(height - one.truth[1].astype(np.float32) / SCALE)[found & stands])
    return {
        "found": float(both / max(there, 1)),
        "right": float(both / max(found_, 1)),
        "iou": float(both / max(found_ + there - both, 1)),
        "median_error_mm": float(1000 * np.median(np.concatenate(errors))) if both else float("nan"),
    }


def train(dataset: GraspDataset, folder: Path, settings: FitSettings) -> tuple[UNet, Values]:
    """Train to the last step, or go on from the checkpoint in the folder; views are kept there, too.

    Returns:
        the network, and what `measure` says of it on held-out views.

    Raises:
        DgsError: REQUEST_INVALID: too few views or scenes to hold some out.
    """
    if min(settings.views, len(dataset.scenes)) <= settings.held_out:
        few = f"{settings.views} views of {len(dataset.scenes)} scenes cannot be trained on"
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{few}: {settings.held_out} are held out")
    torch.manual_seed(settings.seed)
    numbers = trange(settings.views, desc="views")
    samples = [sample(dataset, number, settings, folder / "views") for number in numbers]
    held_out, rest = samples[-settings.held_out :], samples[: -settings.held_out]
    usable = [one for one in rest if np.isfinite(one.truth[0]).any()]
    net = hidden_net()
    batch, judge = partial(crops, usable, settings), partial(measure, samples=held_out)
    return net, fit(net, batch, loss_terms, judge, settings, folder)


def ship_network(net: UNet, measured: Values, settings: FitSettings, folder: Path) -> Path:
    """Write the weights and their card into a folder; returns the file of the weights."""
    rows = {
        "training": f"{settings.steps} steps of {settings.batch} crops of {CROP} x {CROP} cells of {1000 * CELL:.0f} mm"
        f" from {settings.views - settings.held_out} rendered views, seed {settings.seed}",
        f"on {settings.held_out} views of other scenes": f"of the hidden cells in which something stands it finds "
        f"{100 * measured['found']:.0f} %, and of what it finds {100 * measured['right']:.0f} % is there (IoU "
        f"{measured['iou']:.2f}); median error of the height {measured['median_error_mm']:.1f} mm",
    }
    words = (
        "Written by `dgs train-hidden-sides`. Guesses the sides of things that the camera cannot see "
        "(docs/architecture.md).\nTrained on the dataset's procedural objects only."
    )
    return ship(net, folder / f"{NAME}.pt", settings, measured, "Hidden sides", words, rows)

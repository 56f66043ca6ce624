"""Trains the network of hidden sides (`dgs_grasp_planner.contact.hidden`) on rendered views of settled scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import trange

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import OBJECT_HEIGHT, Array, transform
from dgs_description.unet import UNet
from dgs_grasp_planner.contact.height_field import seen_heights
from dgs_grasp_planner.contact.hidden import BELIEVED, NAME, NOTHING, REACH, SCALE, answer, hidden_net, seen
from dgs_grasp_planner.contact.things import CELL
from dgs_grasp_planner.preprocess import CloudSettings, prepare_rows
from dgs_learning.objects.stretched import stretched
from dgs_learning.synthesis.scenes import make_scene
from dgs_learning.training.fit_unet import Values, fit, kept, write_card
from dgs_learning.training.views import ViewSettings, capture
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import Mesh, render

VIEWS = replace(ViewSettings(), distance=(0.4, 1.4), elevation=(0.17, 1.5))
"""From nearly all around, as near as from the wrist."""
OBJECTS, STRETCHED_SHARE = (1, 10), 0.5
"""Objects per scene, and the share of the scenes whose objects are stretched along their axes."""
VIEWS_PER_SCENE = 4
CROP = 112
"""Side of the squares that a step sees, around something hidden [cells]."""
HANGS = 0.008
"""What is seen so much above all that stands within a cell of it hangs [m]."""
TOLERANCE = 0.005
"""Something unseen stands where it is so much higher than what is seen; twice that is forgiven above a shadow [m]."""
FAR = 50.0
"""Height of the camera that looks at the truth: columns stand upright in its picture within 0.5 % [m]."""


@dataclass(frozen=True)
class HiddenSettings:
    """How long to train, and on what.

    Attributes:
        scenes: in all; held_out: the last ones, only measured on.
        steps: updates; batch: crops per step.
        learning_rate: its peak.
        seed: the same seed gives the same views and crops.
    """

    scenes: int = 1000
    held_out: int = 25
    steps: int = 12000
    batch: int = 12
    learning_rate: float = 3e-3
    seed: int = 0


@dataclass(frozen=True)
class Sample:
    """One view.

    Attributes:
        features: (6, X, Y) float16, as the network sees it.
        truth: (3, X, Y) float16: 1 where something unseen stands, 0 where not, NaN where nothing is hidden; its height
            times `SCALE`; 1 where what is seen hangs, 0 where it does not, NaN where nothing is seen.
    """

    features: NDArray[np.float16]
    truth: NDArray[np.float16]


def scene_samples(
    catalogues: Sequence[Sequence[ObjectModel]], seed: int, number: int, stretch: float = STRETCHED_SHARE
) -> list[Sample]:
    """Views of scene `number`, whose objects are of one of the catalogues; fewer where nothing is hidden from a camera."""
    rng = np.random.default_rng([seed, 108, number])
    catalogue = catalogues[int(rng.integers(len(catalogues)))]
    count = min(int(rng.integers(OBJECTS[0], OBJECTS[1] + 1)), len(catalogue))
    models = [catalogue[k] for k in rng.choice(len(catalogue), count, replace=False).tolist()]
    if rng.random() < stretch:
        models = [stretched(model, rng) for model in models]
    scene = make_scene(models, range(count), [seed, 109, number])
    shown = [models[k] for k in scene.objects]
    views = (_sample(shown, scene.T_table_object, rng) for _ in range(VIEWS_PER_SCENE))
    return [one for one in views if one is not None]


def _sample(
    models: Sequence[ObjectModel], T_table_object: Array, rng: np.random.Generator
) -> Sample | None:
    view = capture(models, T_table_object, rng, VIEWS)
    try:
        points = view.points[prepare_rows(view.points, rng, CloudSettings())]
    except DgsError:  # from so near and so flat it looks past everything
        return None
    found = seen_heights(points, REACH)
    if found is None:
        return None
    heights, _, low = found
    what = seen(heights, view.camera, low)
    meshes: list[Mesh] = [(model.vertices, model.faces) for model in models]
    true = true_heights(meshes, T_table_object, heights.shape, low)
    hangs = heights > maximum_filter(true, 3) + HANGS
    known = np.maximum(np.where(hangs, NOTHING, heights), OBJECT_HEIGHT)
    hidden = what.shadow > known
    if not hidden.any():
        return None
    stands = (true > known + TOLERANCE) & (true < what.shadow + 2 * TOLERANCE)
    truth = np.stack(
        [
            np.where(hidden, stands, np.nan),
            np.where(stands, true, 0.0) * SCALE,
            np.where(heights > 0, hangs, np.nan),
        ]
    )
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


def _kept_samples(
    catalogues: Sequence[Sequence[ObjectModel]], settings: HiddenSettings, number: int, folder: Path
) -> list[Sample]:
    """`scene_samples`, kept in a folder."""

    def make() -> dict[str, NDArray]:
        made = scene_samples(catalogues, settings.seed, number)
        return {f"{name}_{k}": value for k, one in enumerate(made) for name, value in vars(one).items()}

    data = kept(folder / f"{number:05d}.npz", make)
    return [Sample(data[f"features_{k}"], data[f"truth_{k}"]) for k in range(len(data) // 2)]


def crops(samples: Sequence[Sample], settings: HiddenSettings, step: int) -> tuple[NDArray, NDArray]:
    """The batch of a step: features (N, 6, CROP, CROP) and truth (N, 3, CROP, CROP), turned and mirrored."""
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


def loss_terms(out: Tensor, truth: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Cross entropy where something is hidden, mean error of the heights where something stands, and cross entropy
    where something is seen.

    Args:
        out: (N, 3, h, w) of the network; truth: (N, 3, h, w) of the samples.
    """
    stands = truth[:, 0].nan_to_num()
    error = ((out[:, 1] - truth[:, 1].nan_to_num()).abs() * stands).sum()
    entropies = _entropy(out[:, 0], truth[:, 0]), _entropy(out[:, 2], truth[:, 2])
    return entropies[0], error / stands.sum().clamp(1.0), entropies[1]


def _entropy(logit: Tensor, truth: Tensor) -> Tensor:
    """Mean where the truth is known."""
    known = torch.isfinite(truth)
    entropy = binary_cross_entropy_with_logits(logit, truth.nan_to_num(), known.float(), reduction="sum")
    return entropy / known.sum().clamp(1)


def measure(net: UNet, samples: Sequence[Sample]) -> Values:
    """Of whole views: what is hidden and found, how much of what is found is there, the error of its height; the same of
    what hangs."""
    hidden, hanging = np.zeros(3), np.zeros(3)
    errors = []
    for one in samples:
        chance, height, hangs = answer(net, one.features.astype(np.float32))
        found = np.isfinite(one.truth[0]) & (chance > BELIEVED)
        stands = one.truth[0] == 1
        hidden += _counts(found, stands)
        hanging += _counts(np.isfinite(one.truth[2]) & (hangs > BELIEVED), one.truth[2] == 1)
        errors.append(np.abs(height - one.truth[1].astype(np.float32) / SCALE)[found & stands])
    return {
        **_shares("", hidden),
        "median_error_mm": float(1000 * np.median(np.concatenate(errors))) if hidden[2] else float("nan"),
        **_shares("hanging_", hanging),
    }


def _counts(found: NDArray, there: NDArray) -> tuple[int, int, int]:
    return found.sum(), there.sum(), (found & there).sum()


def _shares(name: str, counts: NDArray) -> Values:
    found, there, both = counts.tolist()
    return {
        f"{name}found": both / max(there, 1),
        f"{name}right": both / max(found, 1),
        f"{name}iou": both / max(found + there - both, 1),
    }


def train(
    catalogues: Sequence[Sequence[ObjectModel]], folder: Path, settings: HiddenSettings
) -> tuple[UNet, Values]:
    """Train to the last step, or go on from the checkpoint in the folder; views are kept there, too.

    Args:
        catalogues: a scene's objects are of one of them.

    Returns:
        the network, and what `measure` says of it on held-out scenes.

    Raises:
        DgsError: REQUEST_INVALID: too few scenes to hold some out.
    """
    if settings.scenes <= settings.held_out:
        few = f"{settings.scenes} scenes cannot be trained on"
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{few}: {settings.held_out} are held out")
    torch.manual_seed(settings.seed)
    numbers = trange(settings.scenes, desc="scenes")
    scenes = [_kept_samples(catalogues, settings, number, folder / "views") for number in numbers]
    rest, held_out = (
        [one for scene in part for one in scene]
        for part in (scenes[: -settings.held_out], scenes[-settings.held_out :])
    )
    net = hidden_net()
    measured = fit(
        net,
        partial(crops, rest, settings),
        loss_terms,
        partial(measure, samples=held_out),
        settings.steps,
        settings.learning_rate,
        folder,
    )
    return net, measured


def ship_network(net: UNet, measured: Values, settings: HiddenSettings, folder: Path) -> Path:
    """Write the weights and their card into a folder; returns the file of the weights."""
    file = folder / f"{NAME}.pt"
    net.save(file, {**asdict(settings), **measured})
    rows = {
        "file": f"`{file.name}`, {file.stat().st_size / 1e6:.2f} MB, half precision",
        "parameters": f"{sum(p.numel() for p in net.parameters()) / 1e6:.2f} M",
        "training": f"{settings.steps} steps of {settings.batch} crops of {CROP} x {CROP} cells of {1000 * CELL:.0f} mm"
        f" from {VIEWS_PER_SCENE} rendered views each of {settings.scenes - settings.held_out} scenes, seed "
        f"{settings.seed}",
        f"on views of {settings.held_out} other scenes": f"of the hidden cells in which something stands it finds "
        f"{100 * measured['found']:.0f} %, and of what it finds {100 * measured['right']:.0f} % is there (IoU "
        f"{measured['iou']:.2f}); median error of the height {measured['median_error_mm']:.1f} mm. Of what hangs behind "
        f"edges it finds {100 * measured['hanging_found']:.0f} %, and of what it finds "
        f"{100 * measured['hanging_right']:.0f} % hangs",
    }
    words = (
        "Written by `dgs train-hidden-sides`. Guesses the sides of things that the camera cannot see "
        "(docs/architecture.md).\nTrained on the dataset's procedural objects only."
    )
    write_card(file, "Hidden sides", words, rows)
    return file

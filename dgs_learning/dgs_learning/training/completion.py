"""Trains the depth completion (`dgs_perception.completion`) on rendered scenes with objects of glass and mirrors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import trange

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import Array, inverse, transform
from dgs_description.unet import UNet
from dgs_learning.dataset import GraspDataset
from dgs_learning.made_from import mark_folder
from dgs_learning.training.fit_unet import FitSettings, Values, fit, ship
from dgs_learning.training.views import ViewSettings, camera_pose, table_mesh
from dgs_perception.completion import (
    NAME,
    SCALE,
    completion_net,
    depth_of_plane,
    half_rays,
    network_input,
    relative,
)
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.object_model import GLASS, MIRROR, OPAQUE
from dgs_sim_bridge.render.raster import Mesh, box_mesh
from dgs_sim_bridge.render.shot import Stage, take_shot
from dgs_sim_bridge.world.world import World

SHARES = {OPAQUE: 0.5, GLASS: 0.4, MIRROR: 0.1}
"""Of the materials among the objects."""
VIEWS = ViewSettings(distance=(0.7, 1.2))
IN_CELL = 0.5
"""Share of the views that the cell's camera takes: robot, bin, the table's edge and the floor are in the picture."""
ARM_SPREAD, CAMERA_SPREAD = 0.4, (0.05, 0.05)
"""Standard deviations around the robot's home [rad], and the camera's nominal place [m] and direction [rad]."""
CROP = (128, 160)
"""Of the half-resolution image, around an object [px]."""
OPAQUE_WEIGHT = 0.1
"""Weight of pixels that are neither glass nor mirror in the loss of the depth."""
SETTINGS = FitSettings(views=1200, held_out=40, steps=3000, batch=8)
"""Views are of the scenes in turn; those held out have scenes of their own."""


@dataclass(frozen=True)
class Sample:
    """One view at half resolution.

    Attributes:
        features: (4, h, w) float16, as the network sees it.
        truth: (2, h, w) float16: 1 where glass or a mirror is, and the true r times `SCALE`; NaN where nothing is.
        middles: (N, 2) int16 row and column of every visible object.
    """

    features: NDArray[np.float16]
    truth: NDArray[np.float16]
    middles: NDArray[np.int16]


def render_sample(dataset: GraspDataset, number: int, settings: FitSettings) -> Sample:
    """View `number`; the last ones are of scenes of their own."""
    rng = np.random.default_rng([settings.seed, 105, number])
    scene = dataset.scenes[settings.scene_of(number, len(dataset.scenes))]
    models = [dataset.objects[k] for k in scene.objects]
    materials = rng.choice(list(SHARES), len(models), p=list(SHARES.values())).tolist()
    meshes: list[Mesh] = [model.mesh for model in models]
    if rng.random() < IN_CELL:
        stage, T_table_camera = _cell(rng)
    else:
        stage, T_table_camera = Stage([], [], [], table_mesh(None)), camera_pose(rng, VIEWS)
    stage = Stage(
        [*meshes, *stage.meshes],
        [*scene.T_table_object, *stage.poses],
        [*materials, *stage.materials],
        stage.table,
    )
    shot = take_shot(stage, D455, T_table_camera, VIEWS.noise, rng, imagers=1)
    assert shot.left is not None
    seen = network_input(shot.depth, shot.left, D455)
    height, width = seen.features.shape[1:]
    x, y = half_rays(D455)
    true, ids = shot.truth.depth[::2, ::2][:height, :width], shot.truth.ids[::2, ::2][:height, :width]
    r = np.where(true > 0, relative(true, depth_of_plane(seen.plane, x, y)) * SCALE, np.nan)
    clear = np.array([m != OPAQUE for m in stage.materials] + [False, False])[ids]
    places = [np.argwhere(ids == k) for k in range(len(models))]
    middles = [place.mean(0) for place in places if len(place) > 20]
    return Sample(
        seen.features.astype(np.float16),
        np.stack([clear, r]).astype(np.float16),
        np.array(middles, dtype=np.int16).reshape(-1, 2),
    )


def _cell(rng: np.random.Generator) -> tuple[Stage, Array]:
    """The robot's cell without objects in the frame *table*, the arm anywhere near home, and where its camera is."""
    world = World((), np.asarray(HOME_ARM) + rng.normal(0.0, ARM_SPREAD, len(HOME_ARM)))
    seen = world.snapshot().stage
    world.close()
    T_table_base = inverse(CELL.T_base_table)
    # The floor's mesh takes the place of the free views' table; the cell's own table is one of the links.
    floor = CELL.floor_height - CELL.T_base_table[2, 3]
    ground = box_mesh((-3.0, -3.0, floor - 0.1), (3.0, 3.0, floor))
    turn = Rotation.from_rotvec(rng.normal(0.0, CAMERA_SPREAD[1], 3)).as_matrix()
    nudge = transform(turn, rng.normal(0.0, CAMERA_SPREAD[0], 3))
    poses = [T_table_base @ pose for pose in seen.poses]
    T_table_camera = T_table_base @ CELL.T_base_camera_optical @ nudge
    return Stage(seen.meshes, poses, seen.materials, ground), T_table_camera


def sample(dataset: GraspDataset, number: int, settings: FitSettings, cache: Path) -> Sample:
    """`render_sample`, kept in a folder."""
    scene = settings.scene_of(number, len(dataset.scenes))
    file = cache / f"seed{settings.seed}_scene{scene:04d}_view{number:05d}.npz"
    if not file.exists():
        save_arrays(file, vars(render_sample(dataset, number, settings)))
    return Sample(**load_arrays(file))


def crops(samples: Sequence[Sample], settings: FitSettings, step: int) -> tuple[Tensor, Tensor]:
    """The batch of a step: features (N, 4, h, w) and truth (N, 2, h, w) around random objects."""
    usable = [one for one in samples if len(one.middles)]
    rng = np.random.default_rng([settings.seed, 106, step])
    rows = [_crop(usable[rng.integers(len(usable))], rng) for _ in range(settings.batch)]
    features, truth = (
        torch.from_numpy(np.stack(part).astype(np.float32)) for part in zip(*rows, strict=True)
    )
    return features, truth


def _crop(one: Sample, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    middle = one.middles[rng.integers(len(one.middles))] + rng.integers(-30, 31, 2)
    size = np.minimum(CROP, one.truth.shape[1:])
    low = np.clip(middle - size // 2, 0, np.array(one.truth.shape[1:]) - size)
    window = (slice(None), *(slice(a, a + n) for a, n in zip(low, size, strict=True)))
    features, truth = one.features[window], one.truth[window]
    gain = np.array([1.0, 1.0, rng.uniform(0.6, 1.4), 1.0], np.float32)[:, None, None]
    return features * gain, truth


def loss_terms(out: Tensor, truth: Tensor) -> tuple[Tensor, Tensor]:
    """Cross entropy of the mask, and negative log likelihood of r under a Laplace distribution.

    Args:
        out: (N, 3, h, w) of the network; truth: (N, 2, h, w) of the samples.
    """
    clear, r = truth[:, 0], truth[:, 1]
    known = torch.isfinite(r)
    weight = known * (clear + OPAQUE_WEIGHT * (1.0 - clear))
    spread = out[:, 2].clamp(-5.0, 3.0)
    likelihood = (out[:, 1] - r.nan_to_num()).abs() * torch.exp(-spread) + spread
    entropy = binary_cross_entropy_with_logits(out[:, 0], clear)
    return entropy, (weight * likelihood).sum() / weight.sum().clamp(1.0)


def measure(net: UNet, samples: Sequence[Sample]) -> Values:
    """Of whole views: IoU of the mask, and the error of z on glass and mirrors (at 1 m, relative to z) [mm]."""
    both = either = 0.0
    errors, raw = [], []
    with torch.inference_mode():
        for one in samples:
            out = net(torch.from_numpy(one.features.astype(np.float32))[None])[0].numpy()
            clear, r = one.truth[0] > 0, one.truth[1].astype(np.float32) / SCALE
            found = out[0] > 0
            both, either = both + (found & clear).sum(), either + (found | clear).sum()
            here = clear & found & np.isfinite(r)
            errors.append(np.abs((1 + r[here]) / (1 + out[1][here] / SCALE) - 1))
            seen = clear & (one.features[1] > 0)
            raw.append(np.abs((1 + r[seen]) / (1 + one.features[0][seen].astype(np.float32) / SCALE) - 1))
    error, before = 1000 * np.concatenate(errors), 1000 * np.concatenate(raw)
    return {
        "mask_iou": float(both / max(either, 1)),
        "median_error_mm": float(np.median(error)) if len(error) else float("nan"),
        "p90_error_mm": float(np.percentile(error, 90)) if len(error) else float("nan"),
        "raw_median_error_mm": float(np.median(before)) if len(before) else float("nan"),
    }


def train(dataset: GraspDataset, folder: Path, settings: FitSettings) -> tuple[UNet, Values]:
    """Train to the last step, or go on from the checkpoint in the folder; views are kept there, too.

    Returns:
        the network, and what `measure` says of it on held-out views.

    Raises:
        DgsError: REQUEST_INVALID: too few views or scenes to hold some out, the folder's views are of another
            dataset, or as `fit`; WEIGHTS_MISSING, as `fit`.
    """
    torch.manual_seed(settings.seed)
    seen_digest = dataset.seen_digest()
    mark_folder(folder / "views", {"dataset": seen_digest, **VIEWS.described()})
    net = completion_net()
    held_out: list[Sample] = []

    def batches(_: int) -> Callable[[int], tuple[Tensor, Tensor]]:
        numbers = trange(settings.views, desc="views")
        samples = [sample(dataset, number, settings, folder / "views") for number in numbers]
        held_out.extend(samples[-settings.held_out :])
        return partial(crops, samples[: -settings.held_out], settings)

    judge = partial(measure, samples=held_out)
    return net, fit(net, batches, loss_terms, judge, settings, folder, seen_digest)


def ship_network(net: UNet, measured: Values, settings: FitSettings, folder: Path) -> Path:
    """Write the weights and their card into a folder; returns the file of the weights."""
    rows = {
        "training": f"{settings.steps} steps of {settings.batch} crops of {CROP[1]} x {CROP[0]} px from "
        f"{settings.views - settings.held_out} rendered views, seed {settings.seed}",
        "materials": ", ".join(f"{100 * share:.0f} % {name}" for name, share in SHARES.items()),
        f"on {settings.held_out} views of other scenes": f"IoU of the mask {measured['mask_iou']:.2f}; error of z on "
        f"found glass and mirrors at 1 m: median {measured['median_error_mm']:.1f} mm, 90 % below "
        f"{measured['p90_error_mm']:.0f} mm (raw depth, where there is any: median "
        f"{measured['raw_median_error_mm']:.1f} mm)",
    }
    words = (
        "Written by `dgs train-completion`. Fills in the depth of glass and mirrors (docs/depth_sources.md).\n"
        "Trained on rendered images of objects on a table only; no real infrared image was seen."
    )
    return ship(net, folder / f"{NAME}.pt", settings, measured, "Depth completion", words, rows)

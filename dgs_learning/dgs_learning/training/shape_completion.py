"""Trains the shape completion (`dgs_grasp_planner.contact.shape_completion`) on rendered views of the dataset's things.

Every view is of a scene of its own: some things of a stored one are left out, stretched or pushed together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits
from torch.utils.data import DataLoader, Dataset
from tqdm import trange

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError
from dgs_description.frames import OBJECT_HEIGHT, Array, transform
from dgs_description.unet import UNet
from dgs_grasp_planner.contact.height_field import seen_heights
from dgs_grasp_planner.contact.shape_completion import (
    BELIEVED,
    INPUTS,
    NAME,
    REACH,
    SCALE,
    answer,
    completion_net,
    seen,
)
from dgs_grasp_planner.contact.things import CELL
from dgs_grasp_planner.preprocess import prepare_rows
from dgs_learning.dataset import GraspDataset
from dgs_learning.training.fit_unet import FitSettings, Values, fit, ship
from dgs_learning.training.views import ViewSettings, capture_stage, table_mesh
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import Mesh, render
from dgs_sim_bridge.render.shot import Stage

VIEWS = ViewSettings(distance=(0.4, 1.4), elevation=(0.17, 1.5))
"""From nearly all around, as near as from the wrist."""
TABLE_ERROR = 0.0007
"""Standard deviation of the table's height [m]."""
LEFT_OUT, STRETCHED, CROWDED = 0.1, 0.6, 0.5
"""Shares of the things that are left out and stretched, and of the scenes whose things are pushed together."""
SIDEWAYS, UPWARD = (0.6, 1.2), (0.6, 1.5)
"""A thing is stretched by so much along two level axes, and along the vertical."""
BOARDS, FLATTENED = 0.3, 0.3
"""Shares of the scenes in which some things become mats and boards, and of these things."""
WIDE, FLAT, LEAST, MOST = (1.0, 2.5), (0.2, 0.7), 0.009, 0.3
"""How much such a thing is stretched sideways and upward, how high it is at least, how long at most [m]."""
GAPS = (0.0, 0.0, 0.003, 0.01)
"""Between things that are pushed together [m]."""
CROP, PER_VIEW = 128, 4
"""Side of the squares that a step sees [cells], and how many a view gives."""
POOL, FIRST = 4000, 200
"""Squares that a step chooses from are the last so many, and so many views are rendered before the first step."""
FREE = 0.1
"""Weight of cells in which nothing is seen and nothing hidden."""
NEXT = 5
"""Side of the square in which another thing is beside a cell [cells]."""
FAR = 50.0
"""Height of the camera that looks at the truth: columns stand upright in its picture within 0.5 % [m]."""
SETTINGS = FitSettings(views=12000, held_out=100, steps=24000, batch=16, learning_rate=2e-3)
"""Views are of the scenes in turn; those held out have scenes of their own."""


@dataclass(frozen=True)
class Sample:
    """One view.

    Attributes:
        features: (9, X, Y) float32, as the network sees it.
        truth: (5, X, Y) float32: the true height times `SCALE`, 0 = nothing; the way (2) to the thing's middle [0.1 m];
            1 where another thing is beside; 1 where something is seen or hidden.
    """

    features: NDArray[np.float32]
    truth: NDArray[np.float32]


def render_sample(
    meshes: Sequence[Mesh], rng: np.random.Generator, views: ViewSettings = VIEWS
) -> Sample | None:
    """A random view of meshes, frame *table*; None where nothing but the table is seen."""
    view = capture_stage(Stage(meshes, [np.eye(4)] * len(meshes), table=table_mesh(None)), rng, views)
    try:
        points = view.points[prepare_rows(view.points, rng)]
    except DgsError:  # from so near and so flat it looks past everything
        return None
    points[:, 2] += np.float32(rng.normal(0.0, TABLE_ERROR))
    high = points[:, 2] > OBJECT_HEIGHT
    found = seen_heights(points[high], REACH)
    if found is None:
        return None
    heights, _, low = found
    what = seen(heights, points[high], points[~high], view.camera, low)
    care = (what.shadow > np.maximum(heights, OBJECT_HEIGHT)) | (heights > 0)
    return Sample(what.features, np.stack([*truth(meshes, heights.shape, low), care]).astype(np.float32))


def truth(meshes: Sequence[Mesh], size: tuple[int, int], low: Array) -> NDArray[np.float32]:
    """(4, X, Y) as in `Sample`, of meshes in the frame *table*.

    Args:
        size: X, Y; low: (2,) corner of cell (0, 0) [m].
    """
    camera = PinholeCamera.centred(*size, FAR / CELL)
    middle = low + np.array(size) * CELL / 2
    down = transform(np.diag([1.0, -1.0, -1.0]), (*middle, FAR))
    seen_ = render(meshes, [np.eye(4)] * len(meshes), camera, down)
    heights = np.where(seen_.depth > 0, FAR - seen_.depth, 0.0)[::-1].T
    stands = heights > OBJECT_HEIGHT
    number = np.where(stands, seen_.ids[::-1].T, -1)
    cells = np.argwhere(stands)
    owner = number[tuple(cells.T)]
    count = np.maximum(np.bincount(owner, minlength=len(meshes)), 1)
    middles = np.stack([np.bincount(owner, column, len(meshes)) / count for column in cells.T], axis=1)
    way = np.zeros((2, *size))
    way[:, stands] = ((middles[owner] - cells) * CELL * SCALE).T
    highest = maximum_filter(np.where(stands, number, -1), NEXT)
    lowest = minimum_filter(np.where(stands, number, len(meshes)), NEXT)
    return np.stack([heights * SCALE, *way, stands & (highest != lowest)]).astype(np.float32)


def meshes_of(models: Sequence[ObjectModel], poses: Sequence[Array] | Array) -> list[Mesh]:
    """The meshes of objects at their poses (4, 4), frame *table*."""
    return [
        ((model.vertices @ T[:3, :3].T + T[:3, 3]).astype(np.float32), model.faces)
        for model, T in zip(models, poses, strict=True)
    ]


def changed(meshes: Sequence[Mesh], rng: np.random.Generator) -> list[Mesh]:
    """Some of the things, stretched and pushed together."""
    flattened = FLATTENED if rng.random() < BOARDS else 0.0
    kept = [_stretched(mesh, rng, flattened) for mesh in meshes if rng.random() >= LEFT_OUT]
    crowded = flattened > 0 or rng.random() < CROWDED
    return _pushed_together(kept, rng) if len(kept) > 1 and crowded else kept


def _stretched(mesh: Mesh, rng: np.random.Generator, flattened: float) -> Mesh:
    """Some are, a share of all becomes flat and wide."""
    vertices, faces = mesh
    board = rng.random() < flattened
    if not board and rng.random() >= STRETCHED:
        return mesh
    turn = rng.uniform(0.0, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    sideways, upward = rng.uniform(*SIDEWAYS, 2), rng.uniform(*UPWARD)
    if board:
        along, height = vertices @ axes[:, :2], np.ptp(vertices[:, 2])
        sideways = np.minimum(rng.uniform(*WIDE, 2), MOST / np.ptp(along, axis=0))
        upward = max(rng.uniform(*FLAT), LEAST / max(height, 1e-6))
    by = axes * (*sideways, upward) @ axes.T
    foot = np.array([*vertices[:, :2].mean(axis=0), 0.0])
    return ((vertices - foot) @ by.T + foot).astype(np.float32), faces


def _pushed_together(meshes: Sequence[Mesh], rng: np.random.Generator) -> list[Mesh]:
    """Each thing moved towards the middle until it meets another one, the nearest first."""
    side = 800
    taken = np.zeros((side, side), bool)
    places = [vertices[:, :2].mean(axis=0) for vertices, _ in meshes]
    middle = np.mean(places, axis=0)
    out = []
    for k in np.argsort([np.hypot(*(place - middle)) for place in places]):
        vertices, faces = meshes[k]
        away = middle - places[k]
        distance = float(np.hypot(*away))
        towards = away / max(distance, 1e-6)
        corners = vertices[faces[rng.integers(len(faces), size=3000)]]
        inner = (corners * rng.dirichlet((1, 1, 1), size=3000)[:, :, None]).sum(axis=1)
        points = np.concatenate([vertices, inner])[:, :2]
        cells = np.unique(np.floor((points - middle) / CELL).astype(int) + side // 2, axis=0)

        def at(way: float, cells: NDArray = cells, towards: Array = towards) -> tuple[NDArray, ...]:
            return tuple(np.clip(cells + np.round(towards * way / CELL).astype(int), 0, side - 1).T)

        ways = np.arange(-MOST, max(distance, CELL), CELL)  # from outside: stretched things may overlap
        free = next((i for i, way in enumerate(ways) if taken[at(way)].any()), len(ways))
        way = ways[max(free - 1, 0)] - rng.choice(GAPS)
        taken[at(way)] = True
        out.append(((vertices + (*towards * way, 0.0)).astype(np.float32), faces))
    return out


@dataclass(frozen=True)
class Views(Dataset):
    """Squares of views by number: a view depends on its number and the seed alone, whoever renders it."""

    dataset: GraspDataset
    settings: FitSettings

    def sample(self, number: int) -> Sample | None:
        """View `number`; the last ones are of scenes of their own, as they are."""
        settings, data = self.settings, self.dataset
        rng = np.random.default_rng([settings.seed, 107, number])
        scene = data.scenes[settings.scene_of(number, len(data.scenes))]
        models = [data.objects[k] for k in scene.objects]
        meshes = meshes_of(models, scene.T_table_object)
        if number < settings.views - settings.held_out:
            meshes = changed(meshes, rng)
        return render_sample(meshes, rng)

    def __getitem__(self, number: int) -> Tensor:
        """(n, 9 + 5, CROP, CROP) float16, around cells where something is seen or hidden."""
        rng = np.random.default_rng([self.settings.seed, 108, number])
        one = self.sample(number)
        places = np.zeros((0, 2), int) if one is None else np.argwhere(one.truth[-1])
        if one is None or not len(places):
            return torch.zeros((0, INPUTS + 5, CROP, CROP), dtype=torch.float16)
        both = np.concatenate([one.features, one.truth]).astype(np.float16)
        both = np.pad(both, ((0, 0), *[(CROP // 2, CROP // 2)] * 2))
        chosen = places[rng.integers(len(places), size=PER_VIEW)]
        return torch.from_numpy(np.stack([both[:, x : x + CROP, y : y + CROP] for x, y in chosen]))


class Pool:
    """The last squares, from which every step draws its batch while new views come in."""

    def __init__(self, views: Views, step: int) -> None:
        """Begin before a step."""
        self.settings, self.total = views.settings, views.settings.views - views.settings.held_out
        self.device = torch.device(self.settings.device)
        self.squares = torch.zeros((POOL, INPUTS + 5, CROP, CROP), dtype=torch.float16, device=self.device)
        self.count, self.seen = 0, max(0, self._due(step) - POOL // PER_VIEW)
        numbers, workers = range(self.seen, self.total), self.settings.workers
        loader = DataLoader(views, batch_size=None, sampler=numbers, num_workers=workers)  # type: ignore[arg-type]
        self._views = iter(loader)

    def _due(self, step: int) -> int:
        """How many views have been seen at a step: all at the last one."""
        return min(self.total, max(FIRST, (step + 1) * self.total // self.settings.steps))

    def __call__(self, step: int) -> tuple[Tensor, Tensor]:
        """The batch of a step: features (N, 9, CROP, CROP) and truth (N, 5, CROP, CROP)."""
        due = self._due(step)
        for squares in islice(self._views, due - self.seen):
            for square in squares:
                self.squares[self.count % POOL] = square.to(self.device)
                self.count += 1
        self.seen = due
        rng = np.random.default_rng([self.settings.seed, 109, step])
        rows = rng.integers(min(self.count, POOL), size=self.settings.batch)
        batch = self.squares[torch.from_numpy(rows).to(self.device)].float()
        batch = torch.cat([turned(batch[k::8], k) for k in range(8)])
        return batch[:, :INPUTS], batch[:, INPUTS:]


def turned(squares: Tensor, k: int) -> Tensor:
    """Symmetry k of 8 of squares (N, 9 + 5, x, y): mirrored along x and y, and the two exchanged."""
    out, (camera, way) = squares.clone(), (3, INPUTS + 1)  # the directions, two channels each
    for axis in (0, 1):
        if k >> axis & 1:
            out = out.flip(2 + axis)
            out[:, [camera + axis, way + axis]] *= -1
    if k & 4:
        order = list(range(out.shape[1]))
        for first in (camera, way):
            order[first], order[first + 1] = first + 1, first
        out = out.transpose(2, 3)[:, order]
    return out


def loss_terms(out: Tensor, truth: Tensor) -> tuple[Tensor, ...]:
    """Cross entropy of what stands, mean errors of height and way where something does, and cross entropy of borders.

    Args:
        out: (N, 5, h, w) of the network; truth: (N, 5, h, w) of the samples.
    """
    height, way, border, care = truth[:, 0], truth[:, 1:3], truth[:, 3], truth[:, 4]
    stands = (height > OBJECT_HEIGHT * SCALE).float()
    weight, here = care + FREE * (1 - care), stands * care
    count = here.sum().clamp(1.0)

    def entropy(logit: Tensor, true: Tensor, weight: Tensor, more: float = 1.0) -> Tensor:
        more_ = torch.tensor(more, device=logit.device)
        return binary_cross_entropy_with_logits(logit, true, weight, reduction="sum", pos_weight=more_)

    return (
        entropy(out[:, 0], stands, weight) / weight.sum().clamp(1.0),
        ((out[:, 1] - height).abs() * here).sum() / count,
        0.5 * ((out[:, 2:4] - way).abs().sum(dim=1) * here).sum() / count,
        0.3 * entropy(out[:, 4], border, here, 2.0) / count,
    )


def measure(net: UNet, samples: Sequence[Sample]) -> Values:
    """Of whole views: what is hidden and found, how much of what is found there is right, and of all cells the overlap
    with the truth; the same overlap of what is seen; the median error of the height."""
    found = right = hidden = 0
    both = either = both_seen = either_seen = 0
    errors = []
    for one in samples:
        said = answer(net, one.features)
        stands, believed = one.truth[0] > OBJECT_HEIGHT * SCALE, said.chance > BELIEVED
        shown = one.features[1] > 0
        unseen = (one.truth[-1] > 0) & ~shown
        found, hidden = found + (believed & unseen).sum(), hidden + (stands & unseen).sum()
        right += (believed & stands & unseen).sum()
        both, either = both + (believed & stands).sum(), either + (believed | stands).sum()
        both_seen, either_seen = both_seen + (shown & stands).sum(), either_seen + (shown | stands).sum()
        errors.append(np.abs(said.height - one.truth[0] / SCALE)[believed & stands])
    return {
        "found": float(right / max(hidden, 1)),
        "right": float(right / max(found, 1)),
        "iou": float(both / max(either, 1)),
        "seen_iou": float(both_seen / max(either_seen, 1)),
        "median_error_mm": float(1000 * np.median(np.concatenate(errors))) if both else float("nan"),
    }


def train(dataset: GraspDataset, folder: Path, settings: FitSettings) -> tuple[UNet, Values]:
    """Train to the last step, or go on from the checkpoint in the folder.

    Returns:
        the network, and what `measure` says of it on held-out views.

    Raises:
        DgsError: REQUEST_INVALID: too few views or scenes to hold some out, or as `fit`; WEIGHTS_MISSING, as `fit`.
    """
    torch.manual_seed(settings.seed)
    views = Views(dataset, settings)
    net = completion_net()
    held_out: list[Sample] = []

    def batches(step: int) -> Pool:
        late = trange(settings.views - settings.held_out, settings.views, desc="held-out views")
        held_out.extend(one for number in late if (one := views.sample(number)) is not None)
        return Pool(views, step)

    judge = partial(measure, samples=held_out)
    return net, fit(net, batches, loss_terms, judge, settings, folder, dataset.seen_digest())


def ship_network(net: UNet, measured: Values, settings: FitSettings, folder: Path) -> Path:
    """Write the weights and their card into a folder; returns the file of the weights."""
    rows = {
        "training": f"{settings.steps} steps of {settings.batch} squares of {CROP} x {CROP} cells of "
        f"{1000 * CELL:.0f} mm from {settings.views - settings.held_out} rendered views, seed {settings.seed}",
        f"on {settings.held_out} views of other scenes": f"of the hidden cells in which something stands it finds "
        f"{100 * measured['found']:.0f} %, and of what it finds there {100 * measured['right']:.0f} % is right; all "
        f"cells: IoU {measured['iou']:.2f}, of what is seen alone {measured['seen_iou']:.2f}; median error of the "
        f"height {measured['median_error_mm']:.1f} mm",
    }
    words = (
        "Written by `dgs train-shape-completion`. Completes the shapes of things that one view shows in part,\n"
        "and tells them apart (docs/architecture.md)."
    )
    return ship(net, folder / f"{NAME}.pt", settings, measured, "Shape completion", words, rows)

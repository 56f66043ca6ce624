"""How long and how to train, which samples make up which step, and the learning rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dgs_description.errors import DgsError, ErrorCode


@dataclass(frozen=True)
class TrainingSettings:
    """How long and how to train. Defaults: the paper's Adam, batch and learning rate.

    Raises:
        DgsError: REQUEST_INVALID.
    """

    epochs: float = 40.0
    """An epoch has as many samples as there are training scenes times `views_per_scene`."""
    steps: int = 0
    """Updates in all; 0 = as many as the epochs need, else the epochs do not count."""
    batch: int = 10
    """Samples per step, over all processes."""
    learning_rate: float = 1e-3
    warmup: int = 100
    weight_decay: float = 0.01
    clip: float = 1.0
    ema: float = 0.998
    views_per_scene: int = 256
    held_out_scenes: int = 4
    """Scenes at the end of the dataset that are only measured on."""
    training_scenes: int = 0
    """Scenes at its beginning that are trained on; 0 = all that are not held out."""
    teacher: bool = True
    """Module II gets the labels' scores and rotations (paper); else module I's own."""
    seed: int = 0
    workers: int = 1
    device: str = "cpu"
    checkpoint_minutes: float = 3.0
    threads: int = 0
    precision: str = "auto"
    """`fp32`, `bf16` (autocast), or `auto` = bf16 on a GPU, fp32 on a CPU."""
    validate_every: int = 200
    """Steps between two measurements on the held-out scenes; 0 = never."""
    validation_views: int = 2
    """Viewpoints per held-out scene."""

    def __post_init__(self) -> None:
        for name in ("batch", "views_per_scene", "validation_views"):
            if getattr(self, name) < 1:
                raise _refuse(f"{name} is {getattr(self, name)}, it must be at least 1")
        for name in (
            "steps",
            "workers",
            "threads",
            "held_out_scenes",
            "training_scenes",
            "validate_every",
            "warmup",
        ):
            if getattr(self, name) < 0:
                raise _refuse(f"{name} is {getattr(self, name)}, it must not be negative")
        if self.precision not in ("auto", "fp32", "bf16"):
            raise _refuse(f"precision is {self.precision!r}, it must be auto, fp32 or bf16")
        for name in ("learning_rate", "epochs"):
            if not 0 < getattr(self, name) < math.inf:
                raise _refuse(f"{name} is {getattr(self, name)}, it must be positive and finite")

    def scenes_of(self, total: int) -> int:
        """How many scenes of a dataset with `total` of them are trained on.

        Raises:
            DgsError: REQUEST_INVALID; none is left, or fewer than were asked for.
        """
        free = total - self.held_out_scenes
        if free < 1:
            raise _refuse(f"no scene is left to train on: of {total}, {self.held_out_scenes} are held out")
        if self.training_scenes > free:
            raise _refuse(f"training_scenes is {self.training_scenes}, but only {free} are not held out")
        return self.training_scenes or free

    def for_scenes(self, scenes: int) -> TrainingSettings:
        """The settings for a number of training scenes, which they name; `steps` and `epochs` agree."""
        samples = scenes * self.views_per_scene
        steps = self.steps or max(1, round(self.epochs * samples / self.batch))
        epochs = steps * self.batch / samples if self.steps else self.epochs
        return replace(self, steps=steps, epochs=epochs, training_scenes=scenes)


class Sampler:
    """Batches of (scene, view, epoch) keys from a step on.

    Step k of a seed is always the same batch, whatever was before and however many processes share it: of P processes,
    process r takes every P-th key from the r-th on.
    """

    def __init__(
        self, scenes: int, settings: TrainingSettings, first_step: int, rank: int = 0, processes: int = 1
    ):
        """Raise DgsError, REQUEST_INVALID, if the batch cannot be shared evenly."""
        if settings.batch % processes:
            raise _refuse(f"a batch of {settings.batch} cannot be shared by {processes} processes evenly")
        self.scenes, self.settings, self.first_step = scenes, settings.for_scenes(scenes), first_step
        self.rank, self.processes = rank, processes

    def __iter__(self) -> Iterator[list[tuple[int, int, int]]]:
        batch = self.settings.batch
        for step in range(self.first_step, self.settings.steps):
            rng = np.random.default_rng([self.settings.seed, 17, step])
            rounds = [rng.permutation(self.scenes) for _ in range(-(-batch // self.scenes))]
            scenes = np.concatenate(rounds)[:batch]
            views = rng.integers(0, self.settings.views_per_scene, len(scenes))
            keys = [(int(s), int(v), step) for s, v in zip(scenes, views, strict=True)]
            yield keys[self.rank :: self.processes]

    def __len__(self) -> int:
        return self.settings.steps - self.first_step


def learning_rate(step: int, settings: TrainingSettings) -> float:
    """Linear warm-up, then a cosine down to 2 % of the peak."""
    if step < settings.warmup:
        return settings.learning_rate * (step + 1) / settings.warmup
    share = (step - settings.warmup) / max(1, settings.steps - settings.warmup)
    return settings.learning_rate * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(share, 1.0))))


def _refuse(sentence: str) -> DgsError:
    return DgsError(ErrorCode.REQUEST_INVALID, f"training settings: {sentence}")

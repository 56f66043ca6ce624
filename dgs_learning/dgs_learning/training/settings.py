"""How long and how to train, which samples make up which step, and the learning rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from dgs_description.errors import DgsError, ErrorCode


def _option(default: Any, text: str, *, least: float | None = None, also: str = "") -> Any:
    """A field: its default, the help of its command-line option, its least value, and a shorter name of the option."""
    return field(default=default, metadata={"help": text, "least": least, "also": also})


@dataclass(frozen=True)
class TrainingSettings:
    """How long and how to train; every field is an option of the command. Defaults: the paper's Adam, batch and rate.

    Raises:
        DgsError: REQUEST_INVALID.
    """

    epochs: float = _option(40.0, "passes over all training scenes and their views")
    steps: int = _option(0, "updates in all; 0 = as the epochs say, else the epochs do not count", least=0)
    minutes: float = _option(
        0.0, "ends after so long if the steps are not done, its rate falls with the time", least=0
    )
    batch: int = _option(10, "samples per step, over all processes", least=1)
    learning_rate: float = _option(1e-3, "peak of the rate")
    warmup: int = _option(100, "steps until the rate is at its peak", least=0)
    ema: float = _option(0.998, "decay of the averaged weights", least=0)
    views_per_scene: int = _option(256, "viewpoints per scene", least=1, also="views")
    held_out_scenes: int = _option(4, "last scenes, only measured on", least=0, also="held-out")
    training_scenes: int = _option(0, "first scenes, trained on; 0 = all others", least=0, also="scenes")
    grasps_per_object: int = _option(
        0, "stage-1 grasps of each object that are taught, drawn at random; 0 = all", least=0, also="grasps"
    )
    teacher: bool = _option(True, "module II gets the labels' scores and rotations (paper), not module I's")
    seed: int = _option(0, "of weights, samples and augmentation", least=0)
    workers: int = _option(1, "processes that prepare views", least=0)
    device: str = _option("cpu", "cpu, cuda or cuda:1")
    checkpoint_minutes: float = _option(3.0, "between two checkpoints", least=0)
    threads: int = _option(0, "torch threads; 0 = torch's default", least=0)
    precision: str = _option("auto", "fp32, bf16 (autocast), or auto = bf16 where it is faster")
    validate_every: int = _option(200, "steps between measurements on held-out scenes; 0 = never", least=0)

    def __post_init__(self) -> None:
        for setting in fields(self):
            value, least = getattr(self, setting.name), setting.metadata["least"]
            if least is not None and not value >= least:
                raise _refuse(f"{setting.name} is {value}, it must be at least {least}")
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

    def __init__(self, settings: TrainingSettings, first_step: int, rank: int = 0, processes: int = 1):
        """`settings`: as `for_scenes` gives them. DgsError, REQUEST_INVALID, if the batch cannot be shared evenly."""
        if settings.batch % processes:
            raise _refuse(f"a batch of {settings.batch} cannot be shared by {processes} processes evenly")
        self.settings, self.first_step, self.rank, self.processes = settings, first_step, rank, processes

    def __iter__(self) -> Iterator[list[tuple[int, int, int]]]:
        batch, total = self.settings.batch, self.settings.training_scenes
        for step in range(self.first_step, self.settings.steps):
            rng = np.random.default_rng([self.settings.seed, 17, step])
            rounds = [rng.permutation(total) for _ in range(-(-batch // total))]
            scenes = np.concatenate(rounds)[:batch]
            views = rng.integers(0, self.settings.views_per_scene, len(scenes))
            keys = [(int(s), int(v), step) for s, v in zip(scenes, views, strict=True)]
            yield keys[self.rank :: self.processes]

    def __len__(self) -> int:
        return self.settings.steps - self.first_step


def learning_rate(step: int, settings: TrainingSettings, spent: float = 0.0) -> float:
    """Linear warm-up, then a cosine down to 2 % of the peak, by the steps or the share `spent` of the time."""
    if step < settings.warmup:
        return settings.learning_rate * (step + 1) / settings.warmup
    share = max(spent, (step - settings.warmup) / max(1, settings.steps - settings.warmup))
    return settings.learning_rate * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(share, 1.0))))


def _refuse(sentence: str) -> DgsError:
    return DgsError(ErrorCode.REQUEST_INVALID, f"training settings: {sentence}")

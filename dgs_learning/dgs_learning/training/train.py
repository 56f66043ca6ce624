"""The training loop.

Seeded, resumable to the step, on a CPU or several GPUs, with an averaged copy of the weights and a CSV of the curves.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.utils.data import DataLoader

from dgs_grasp_planner.network import DGSNet, NetworkConfig, load_network, save_network
from dgs_grasp_planner.runtime import release_memory
from dgs_learning.training.batches import Augmentation, Collator, TrainingBatch, ViewDataset
from dgs_learning.training.clock import StepClock
from dgs_learning.training.curve import HELD_OUT, TRAIN, CurveLog
from dgs_learning.training.labels import LabelSettings
from dgs_learning.training.losses import LossWeights
from dgs_learning.training.objective import Objective
from dgs_learning.training.processes import Place, find_device
from dgs_learning.training.settings import Sampler, TrainingSettings, learning_rate
from dgs_learning.training.views import ViewSource

__all__ = ["Trainer", "TrainingSettings", "label_settings"]

REPORT_EVERY = 10


def label_settings(config: NetworkConfig) -> LabelSettings:
    """The paper's labels for the paper's network, denser supervision for the others."""
    paper = config.name == "paper"
    return LabelSettings(supervise_candidates=not paper, unknown_objects=not paper)


def mean_terms(terms: Sequence[dict[str, Tensor]]) -> dict[str, float]:
    """Mean per term over steps or batches, those without a value left out; NaN if there is none."""
    return {k: float(torch.stack([t[k] for t in terms]).nanmean()) for k in terms[0]}


class Trainer:
    """Network, optimiser, averaged weights and the place where they are kept."""

    def __init__(
        self,
        config: NetworkConfig,
        source: ViewSource,
        folder: Path,
        settings: TrainingSettings,
        loss_weights: LossWeights | None = None,
        labels: LabelSettings | None = None,
        augmentation: Augmentation | None = None,
        place: Place | None = None,
        notes: dict[str, Any] | None = None,
    ):
        """Build an untrained network.

        Args:
            config: of the network.
            source: of the views.
            folder: of checkpoint, averaged weights and curves.
            settings: how long and how.
            loss_weights, labels, augmentation: None = the usual ones.
            place: of this process among several; None = alone, on the device that the settings name.
            notes: what else the weights shall say about themselves, JSON-ready.
        """
        torch.manual_seed(settings.seed)
        if settings.threads:
            torch.set_num_threads(settings.threads)
        settings = settings.for_scenes(settings.scenes_of(len(source.dataset.scenes)))
        self.config, self.source, self.folder, self.settings = config, source, folder, settings
        self.init: dict[str, Any] | None = None
        self.place = place or Place(0, 1, find_device(settings.device))
        self.device = self.place.device
        self.notes = notes or {}
        self.labels = labels or label_settings(config)
        self.augmentation = augmentation or Augmentation()
        self.net = DGSNet(config).to(self.device)
        self.objective = Objective(self.net, loss_weights or LossWeights(), settings.teacher)
        self._shared: nn.Module = self.objective
        if self.place.processes > 1:
            gpus = [self.device.index] if self.device.type == "cuda" else None
            self._shared = DistributedDataParallel(
                self.objective, device_ids=gpus, broadcast_buffers=False, gradient_as_bucket_view=True
            )
        self.averaged = {k: v.detach().clone().float() for k, v in self.net.state_dict().items()}
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.clock = StepClock(self.device)
        self.step = 0
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def checkpoint(self) -> Path:
        """The file that a stopped run goes on from."""
        return self.folder / "checkpoint.pt"

    @property
    def curve(self) -> Path:
        """The file of the curves."""
        return self.folder / "curve.csv"

    def save(self) -> None:
        """Write the checkpoint atomically, and the averaged weights beside it as a loadable model."""
        state = {
            "step": self.step,
            "net": self.net.state_dict(),
            "averaged": self.averaged,
            "optimiser": self.optimiser.state_dict(),
            "init": self.init,
        }
        partial = self.checkpoint.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(self.checkpoint)
        self.export("latest")

    def export(self, name: str, folder: Path | None = None, notes: dict[str, Any] | None = None) -> None:
        """Write the averaged weights as `<name>.pt` and `<name>.json`."""
        net = DGSNet(self.config)
        net.load_state_dict({k: v.to(net.state_dict()[k].dtype) for k, v in self.averaged.items()})
        save_network(
            net,
            folder or self.folder,
            name,
            {
                "step": self.step,
                "training": asdict(self.settings),
                "init": self.init,
                **self.notes,
                **(notes or {}),
            },
        )

    def resume(self) -> bool:
        """Go on from the checkpoint if there is one."""
        if not self.checkpoint.exists():
            return False
        state = torch.load(self.checkpoint, map_location=self.device, weights_only=True)
        self.net.load_state_dict(state["net"])
        self.averaged = state["averaged"]
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = int(state["step"])
        self.init = state.get("init")
        return True

    def start_from(self, directory: Path, name: str) -> None:
        """Take over the weights of `<name>.pt`, for the network and its average; the optimiser starts anew.

        Raises:
            DgsError: WEIGHTS_MISSING or WEIGHTS_ALTERED.
        """
        net, info = load_network(directory, name)
        self.net.load_state_dict(net.state_dict())
        self.averaged = {k: v.detach().clone().float() for k, v in self.net.state_dict().items()}
        self.init = {"model_id": info.model_id, "sha256": info.sha256, "step": info.notes.get("step")}

    def loader(self) -> DataLoader:
        """This process's share of the batches from the present step on."""
        scenes = self.settings.scenes_of(len(self.source.dataset.scenes))
        if self.settings.workers:
            _allow_many_files()
        return DataLoader(
            ViewDataset(self.source, self.augmentation, self.settings.seed),
            batch_sampler=Sampler(scenes, self.settings, self.step, self.place.rank, self.place.processes),
            collate_fn=self.collator,
            num_workers=self.settings.workers,
            prefetch_factor=4 if self.settings.workers else None,
            pin_memory=self.device.type == "cuda",
        )

    @property
    def collator(self) -> Collator:
        """What makes batches of samples for this device."""
        return Collator(self.config, self.labels, with_pairs=self.device.type == "cpu")

    def _autocast(self) -> torch.autocast:
        wanted = self.settings.precision
        on = wanted == "bf16" or (wanted == "auto" and self.device.type == "cuda")
        return torch.autocast(self.device.type, torch.bfloat16, enabled=on)

    def train_step(self, batch: TrainingBatch) -> dict[str, Tensor]:
        """One update; returns the terms of the loss."""
        self.net.train()
        # What is drawn inside the step (stochastic depth) depends on its number alone: a resumed run draws the same.
        seed = (self.settings.seed * 1_000_003 + self.step) * self.place.processes + self.place.rank
        torch.manual_seed(seed % (1 << 63))
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.step, self.settings)
        with self._autocast():
            total, terms = self._shared(batch.to(self.device, non_blocking=True))
        self.clock.lap("forward")
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        self.clock.lap("backward")
        nn.utils.clip_grad_norm_(self.net.parameters(), self.settings.clip)
        self.optimiser.step()
        self.step += 1
        decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.net.state_dict().items():
                self.averaged[name].lerp_(value.float(), 1 - decay)
        self.clock.lap("optimiser")
        return terms

    @cached_property
    def _held_out(self) -> list[TrainingBatch]:
        """Batches of the held-out scenes, always the same and not augmented; kept, for they are few."""
        total, count = len(self.source.dataset.scenes), self.settings.held_out_scenes
        views = ViewDataset(self.source, None, self.settings.seed)
        keys = [(s, v, 0) for s in range(total - count, total) for v in range(self.settings.validation_views)]
        size = min(self.settings.batch, 16)
        parts = [keys[k : k + size] for k in range(0, len(keys), size)]
        return [self.collator([views[key] for key in part]) for part in parts]

    def validate(self) -> dict[str, float]:
        """Mean terms of the averaged weights on the held-out scenes."""
        self.net.eval()
        weights = {f"net.{name}": value for name, value in self.averaged.items()}
        with torch.no_grad(), self._autocast():
            terms = [
                torch.func.functional_call(self.objective, weights, (batch.to(self.device),))[1]
                for batch in self._held_out
            ]
        return mean_terms(terms)

    def run(self) -> None:
        """Train to the last step; the first process prints, logs, measures and saves as it goes."""
        log = CurveLog(self.curve) if self.place.first else None
        if log is not None:
            log.rewind(self.step)
        saved, busy, first = time.monotonic(), 0.0, self.step
        recent: list[dict[str, Tensor]] = []
        begin = time.monotonic()
        for batch in self._batches():
            recent.append(self.train_step(batch))
            last = self.step == self.settings.steps
            if log is None:
                recent = []
                continue
            if self.step % REPORT_EVERY == 0 or last:
                means = mean_terms(recent)
                busy += time.monotonic() - begin
                self._report(log, means, (self.step - first) * self.settings.batch / busy)
                recent = []
                self._validate_if_due(log, last)
                release_memory()
                begin = time.monotonic()
            if time.monotonic() - saved > 60 * self.settings.checkpoint_minutes:
                self.save()
                saved = time.monotonic()
        if log is not None:
            self.save()

    def _batches(self) -> Iterator[TrainingBatch]:
        self.clock.wait()
        for batch in self.loader():
            self.clock.batch(self.step)
            yield batch
            self.clock.wait()

    def _validate_if_due(self, log: CurveLog, last: bool) -> None:
        every = self.settings.validate_every
        if every and self.settings.held_out_scenes and (last or self.step % max(every, REPORT_EVERY) == 0):
            means = self.validate()
            log.append(self.step, HELD_OUT, means)
            print(f"held out {self.step}  {_text(means)}", flush=True)

    def _report(self, log: CurveLog, means: dict[str, float], rate: float) -> None:
        left = (self.settings.steps - self.step) * self.settings.batch / max(rate, 1e-9)
        times = self.clock.means()
        print(
            f"step {self.step}/{self.settings.steps} {rate:.2f} samples/s left {left / 60:.0f} min  "
            f"{_text(means)}  {_text(times)}",
            flush=True,
        )
        log.append(self.step, TRAIN, {"samples_per_s": rate, **means, **times})


def _text(values: dict[str, float]) -> str:
    return " ".join(f"{name} {value:.3g}" for name, value in values.items() if not np.isnan(value))


def _allow_many_files() -> None:
    """Every tensor that waits in a worker's queue holds an open file; the usual limit of 1024 is soon reached."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = 65536 if hard == resource.RLIM_INFINITY else min(65536, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))

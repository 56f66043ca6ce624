"""The training loop: resumable to the step, on a CPU or several GPUs, with averaged weights and a CSV of curves."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import deepcopy
from dataclasses import asdict
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torch.utils.data import DataLoader

from dgs_description import malloc
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.stage_clock import StageClock
from dgs_grasp_planner.network import DGSNet, NetworkConfig, save_network
from dgs_grasp_planner.network.fixed_shapes import FixedShapes
from dgs_grasp_planner.network.weights import load_trunk
from dgs_grasp_planner.runtime import choose_dtype, pairs_pay
from dgs_learning.training.batches import TrainingBatch, ViewDataset, make_batch
from dgs_learning.training.checkpoint import read_checkpoint
from dgs_learning.training.curve import HELD_OUT, TRAIN, CurveLog
from dgs_learning.training.finite_steps import FiniteSteps
from dgs_learning.training.labels import typical_shapes
from dgs_learning.training.losses import Objective
from dgs_learning.training.settings import Sampler, TrainingSettings, learning_rate
from dgs_learning.training.views import ViewSource

REPORT_EVERY = 10
WEIGHT_DECAY = 0.01
VALIDATION_VIEWS = 2
"""Viewpoints per held-out scene."""
KEPT = ("seed", "batch", "training_scenes", "views_per_scene", "grasps_per_object", "teacher")
"""Settings with which alone a training goes on."""


def find_device(wanted: str) -> torch.device:
    """The device of a name (`cpu`, `cuda`, `cuda:1`); of torchrun's processes each takes its own GPU.

    Raises:
        DgsError: REQUEST_INVALID where there is no such GPU: a training on a CPU by mistake would take weeks.
    """
    if not re.fullmatch(r"cpu|cuda(:[1-9]?\d)?", wanted):
        unknown = f"there is no device {wanted!r}; there are cpu, cuda and cuda:1"
        raise DgsError(ErrorCode.REQUEST_INVALID, unknown)
    device = torch.device(wanted)
    if device.type != "cuda":
        return device
    index = int(os.environ.get("LOCAL_RANK", "0")) if device.index is None else device.index
    count = torch.cuda.device_count()
    if not torch.cuda.is_available() or index >= count:
        said = f"GPU {index} was asked for, torch sees {count}: take --device cpu"
        raise DgsError(ErrorCode.REQUEST_INVALID, said)
    torch.cuda.set_device(index)
    # With a mask its gradients are NaN for some lengths of the windows (pytorch/pytorch#196678, torch from 2.11 on).
    torch.backends.cuda.enable_cudnn_sdp(False)
    return torch.device("cuda", index)


def mean_terms(terms: Sequence[dict[str, Tensor]]) -> dict[str, float]:
    """Mean per term over steps or batches, those without a value left out; NaN if there is none."""
    return {k: float(torch.stack([t[k] for t in terms]).nanmean()) for k in terms[0]}


class Trainer:
    """Network, optimiser, averaged weights and the place where they are kept.

    Attributes:
        rank, processes: of this process among those of torchrun; the one of rank 0 measures, prints and writes.
        averaged: the network with the averaged weights.
        clock: seconds per stage since the last report.
        steps: of the optimiser.
        seconds: that the training has taken so far.
    """

    def __init__(
        self,
        config: NetworkConfig,
        source: ViewSource,
        folder: Path,
        settings: TrainingSettings,
        notes: dict[str, Any] | None = None,
    ):
        """Build an untrained network.

        Args:
            config: of the network.
            folder: of checkpoint, averaged weights and curves.
            notes: what else the weights shall say about themselves, JSON-ready.
        """
        torch.manual_seed(settings.seed)
        if settings.threads:
            torch.set_num_threads(settings.threads)
        settings = settings.for_scenes(settings.scenes_of(len(source.dataset.scenes)))
        self.source, self.folder, self.settings, self.notes = source, folder, settings, notes or {}
        self.init: dict[str, Any] | None = None
        self.rank, self.processes = 0, 1
        if dist.is_initialized():
            self.rank, self.processes = dist.get_rank(), dist.get_world_size()
        self.device = find_device(settings.device)
        self.net = DGSNet(config).to(self.device)
        if isinstance(self.net.two, FixedShapes):
            self.net.two.shapes.copy_(
                torch.from_numpy(typical_shapes(source.dataset.grasps, config.fixed_shapes))
            )
        self.averaged = deepcopy(self.net).eval().requires_grad_(False)
        objective = Objective(self.net, teacher=settings.teacher)
        self._shared: nn.Module = objective
        if self.processes > 1:
            gpus = [self.device.index] if self.device.type == "cuda" else None
            self._shared = DistributedDataParallel(
                objective, device_ids=gpus, broadcast_buffers=False, gradient_as_bucket_view=True
            )
        on_gpu = self.device.type == "cuda"
        self.optimiser = torch.optim.AdamW(self.net.parameters(), weight_decay=WEIGHT_DECAY, fused=on_gpu)
        self.steps = FiniteSteps(self.optimiser)
        self.dtype = choose_dtype(settings.precision, self.device)
        self.collate = partial(make_batch, config=config, with_pairs=pairs_pay(self.device, self.dtype))
        self.clock = StageClock()
        self.step, self.seconds = 0, 0.0
        folder.mkdir(parents=True, exist_ok=True)
        self.checkpoint, self.curve = folder / "checkpoint.pt", folder / "curve.csv"

    def save(self) -> None:
        """Write the checkpoint atomically, and the averaged weights beside it as a loadable model."""
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "net": self.net.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "init": self.init,
            "made_from": self._made_from(),
        }
        with atomic_write(self.checkpoint) as file:
            torch.save(state, file)
        notes = {"step": self.step, "training": asdict(self.settings), "init": self.init, **self.notes}
        save_network(self.averaged, self.folder, "latest", notes)

    def resume(self) -> bool:
        """Go on from the checkpoint if there is one.

        Raises:
            DgsError: REQUEST_INVALID: it is damaged, of another network or dataset, or of other settings among `KEPT`.
        """
        if not self.checkpoint.exists():
            return False
        state = read_checkpoint(self.checkpoint, self.device, self._made_from())
        self.net.load_state_dict(state["net"])
        self.averaged.load_state_dict(state["averaged"])
        self.optimiser.load_state_dict(state["optimiser"])
        for group in self.optimiser.param_groups:  # the part before may have run elsewhere
            group["fused"] = self.device.type == "cuda"
        self.step, self.init = int(state["step"]), state.get("init")
        self.seconds = float(state.get("seconds", 0.0))
        return True

    def _made_from(self) -> dict[str, Any]:
        kept = {name: getattr(self.settings, name) for name in KEPT}
        return self.net.config.to_dict() | {"dataset": self.notes.get("dataset", {}).get("sha256")} | kept

    def start_from(self, directory: Path, name: str) -> None:
        """Take over the weights of `<name>.pt`, for the network and its average; the optimiser starts anew.

        Weights for another hand give all but the joints.

        Raises:
            DgsError: WEIGHTS_MISSING or WEIGHTS_ALTERED.
        """
        for own in (self.net, self.averaged):
            info = load_trunk(own, directory, name)
        self.init = {"model_id": info.model_id, "sha256": info.sha256, "step": info.notes.get("step")}

    def loader(self) -> DataLoader:
        """This process's share of the batches from the present step on."""
        settings = self.settings
        if settings.workers:
            _allow_many_files()
        return DataLoader(
            ViewDataset(self.source, settings.seed, augmented=True),
            batch_sampler=Sampler(settings, self.step, self.rank, self.processes),
            collate_fn=self.collate,
            num_workers=settings.workers,
            prefetch_factor=4 if settings.workers else None,
            worker_init_fn=_give_way,
            pin_memory=self.device.type == "cuda",
        )

    def _autocast(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == torch.bfloat16)

    @contextmanager
    def _stage(self, name: str, measured: bool) -> Iterator[None]:
        if not measured:
            yield
            return
        wait = torch.cuda.synchronize if self.device.type == "cuda" else lambda: None
        wait()
        with self.clock(name):
            yield
            wait()

    def train_step(self, batch: TrainingBatch, measured: bool = True) -> dict[str, Tensor]:
        """One update; returns the terms of the loss. `measured`: its stages are timed, with waits for a GPU.

        Raises:
            DgsError: as of `FiniteSteps.take`.
        """
        self.net.train()
        # What is drawn inside the step (stochastic depth) depends on its number alone: a resumed run draws the same.
        seed = (self.settings.seed * 1_000_003 + self.step) * self.processes + self.rank
        torch.manual_seed(seed % (1 << 63))
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.step, self.settings, self.spent)
        with self._stage("forward", measured), self._autocast():
            total, terms = self._shared(batch.to(self.device, non_blocking=True))
        with self._stage("backward", measured):
            self.optimiser.zero_grad(set_to_none=True)
            total.backward()
        with self._stage("optimiser", measured):
            self.steps.take(self.net.parameters(), self.step)
            self.step += 1
            decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
            get_ema_multi_avg_fn(decay)(list(self.averaged.parameters()), list(self.net.parameters()), None)
        return terms

    @cached_property
    def _held_out(self) -> list[TrainingBatch]:
        """Batches of the held-out scenes, always the same and not augmented; kept, for they are few."""
        total, count = len(self.source.dataset.scenes), self.settings.held_out_scenes
        views = ViewDataset(self.source, self.settings.seed, augmented=False)
        keys = [(s, v, 0) for s in range(total - count, total) for v in range(VALIDATION_VIEWS)]
        size = min(self.settings.batch, 16)
        parts = [keys[k : k + size] for k in range(0, len(keys), size)]
        return [self.collate([views[key] for key in part]) for part in parts]

    def validate(self) -> dict[str, float]:
        """Mean terms of the averaged weights on the held-out scenes."""
        objective = Objective(self.averaged, teacher=self.settings.teacher)
        with torch.no_grad(), self._autocast():
            return mean_terms([objective(batch.to(self.device))[1] for batch in self._held_out])

    def run(self) -> None:
        """Train to the last step, or until the time is over; the first process prints, logs, measures and saves."""
        log = CurveLog(self.curve, self.step) if self.rank == 0 else None
        recent: list[dict[str, Tensor]] = []
        busy, first = 0.0, self.step
        saved = begin = time.monotonic()
        started = begin - self.seconds
        for batch in self._batches():
            recent.append(self.train_step(batch, self._every_step_is_measured or len(recent) == 1))
            self._spend(time.monotonic() - started)
            if log is None:
                recent = []
                continue
            if self.step % REPORT_EVERY == 0 or self.over:
                means, times = mean_terms(recent), self._times(len(recent))
                busy += time.monotonic() - begin
                self._report(log, (self.step - first) * self.settings.batch / busy, means, times)
                recent = []
                malloc.trim()  # tensors of changing size leave holes: 1.4 GB after 30 steps
                begin = time.monotonic()
            if time.monotonic() - saved > 60 * self.settings.checkpoint_minutes:
                self.save()
                saved = time.monotonic()
        if log is not None:
            self.save()

    def _batches(self) -> Iterator[TrainingBatch]:
        batches = iter(self.loader())
        while not self.over:
            with self.clock("data"):
                batch = next(batches)
            yield batch

    @property
    def over(self) -> bool:
        """Whether the last step is done or the time is over."""
        return self.step >= self.settings.steps or self.spent >= 1.0

    @property
    def spent(self) -> float:
        """Share of the training's time that is over; 0 where it is not limited."""
        return self.seconds / (60 * self.settings.minutes) if self.settings.minutes else 0.0

    def _spend(self, seconds: float) -> None:
        """Look at the clock, the first process for all: each by its own would leave the others waiting at the end."""
        if self.settings.minutes and self.processes > 1:
            told = torch.tensor([seconds], device=self.device)
            dist.broadcast(told, 0)
            seconds = float(told)
        self.seconds = seconds

    @property
    def _every_step_is_measured(self) -> bool:
        """On a GPU one step per report is: measuring makes the host wait for the GPU."""
        return self.device.type != "cuda"

    def _times(self, steps: int) -> dict[str, float]:
        """Mean seconds per stage over the last `steps` steps: `data_s`, the wait for a batch, `forward_s`, ..."""
        times, self.clock = self.clock.times, StageClock()
        measured = steps if self._every_step_is_measured else 1
        return {f"{name}_s": t / (steps if name == "data" else measured) for name, t in times.items()}

    def _report(self, log: CurveLog, rate: float, means: dict[str, float], times: dict[str, float]) -> None:
        """Of the training, and where it is due of the held-out scenes."""
        settings = self.settings
        left = (settings.steps - self.step) * settings.batch / max(rate, 1e-9)
        if settings.minutes:
            left = max(min(left, 60 * settings.minutes - self.seconds), 0.0)
        head = f"step {self.step}/{settings.steps} {rate:.2f} samples/s left {left / 60:.0f} min"
        print(f"{head}  {_text(means)}  {_text(times)}", flush=True)
        log.append(self.step, TRAIN, {"samples_per_s": rate, **means, **times})
        every, last = -(-settings.validate_every // REPORT_EVERY) * REPORT_EVERY, self.over
        if every and settings.held_out_scenes and (last or self.step % every == 0):
            held_out = self.validate()
            log.append(self.step, HELD_OUT, held_out)
            print(f"held out {self.step}  {_text(held_out)}", flush=True)


def _text(values: dict[str, float]) -> str:
    return " ".join(f"{name} {value:.3g}" for name, value in values.items() if not np.isnan(value))


def _give_way(_: int) -> None:
    """What prepares views lets the process go first that hands the GPU its work."""
    os.nice(10)


def _allow_many_files() -> None:
    """Every tensor that waits in a worker's queue holds an open file; the usual limit of 1024 is soon reached."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = 65536 if hard == resource.RLIM_INFINITY else min(65536, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted), hard))

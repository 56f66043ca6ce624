"""The training loop.

Seeded, resumable to the step, with an averaged copy of the weights and a CSV of the curves.
"""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader

from dgs_grasp_planner.network import DGSNet, NetworkConfig, save_network
from dgs_grasp_planner.network.dgs_net import likeliest_rotation, teacher_logits
from dgs_grasp_planner.network.rotation import sixd_from_matrix
from dgs_learning.training.batches import Augmentation, Collator, TrainingBatch, ViewDataset
from dgs_learning.training.labels import LabelSettings
from dgs_learning.training.losses import (
    LossWeights,
    graspable,
    joint_loss,
    offset_loss,
    rotation_loss,
    score_loss,
)
from dgs_learning.training.views import ViewSource


@dataclass(frozen=True)
class TrainingSettings:
    """How long and how to train. Defaults: the paper's Adam, batch and epochs."""

    steps: int = 2000
    batch: int = 10
    learning_rate: float = 1e-3
    warmup: int = 100
    weight_decay: float = 0.01
    clip: float = 1.0
    ema: float = 0.998
    views_per_scene: int = 256
    held_out_scenes: int = 4
    """Scenes at the end of the dataset that are only measured on."""
    teacher: bool = True
    """Module II gets the labels' scores and rotations (paper); else module I's own."""
    seed: int = 0
    workers: int = 1
    device: str = "cpu"
    checkpoint_minutes: float = 3.0
    threads: int = 0


class Sampler:
    """Batches of (scene, view, epoch) keys from a step on: step k of a seed is always the same batch."""

    def __init__(self, scenes: int, settings: TrainingSettings, first_step: int):
        self.scenes, self.settings, self.first_step = scenes, settings, first_step

    def __iter__(self) -> Iterator[list[tuple[int, int, int]]]:
        for step in range(self.first_step, self.settings.steps):
            rng = np.random.default_rng([self.settings.seed, 17, step])
            scenes = rng.permutation(self.scenes)[: self.settings.batch]
            views = rng.integers(0, self.settings.views_per_scene, len(scenes))
            yield [(int(s), int(v), step) for s, v in zip(scenes, views, strict=True)]

    def __len__(self) -> int:
        return self.settings.steps - self.first_step


def learning_rate(step: int, settings: TrainingSettings) -> float:
    """Linear warm-up, then a cosine down to 2 % of the peak."""
    if step < settings.warmup:
        return settings.learning_rate * (step + 1) / settings.warmup
    share = (step - settings.warmup) / max(1, settings.steps - settings.warmup)
    return settings.learning_rate * (0.02 + 0.98 * 0.5 * (1 + math.cos(math.pi * min(share, 1.0))))


def losses(
    net: DGSNet, batch: TrainingBatch, weights: LossWeights, teacher: bool = True
) -> tuple[Tensor, dict[str, float]]:
    """Equation (6) for one batch, and its terms with a few readable errors.

    Module II sees the ground truth at the labelled voxels, one grasp drawn per voxel, and module I's rotation
    elsewhere.
    """
    one = net.module_one(batch.voxels)
    gp = score_loss(one.score_logits, batch.kind)
    rotation, hypothesis, angle = rotation_loss(
        one.rotation6d[batch.voxel], one.hypothesis_logits[batch.voxel], batch.rotation, batch.weight, weights
    )
    chosen = batch.chosen
    rows = batch.voxel[chosen]
    fed = likeliest_rotation(one.rotation6d, one.hypothesis_logits).detach().float()
    score = one.score_logits.detach()
    if teacher:
        fed = fed.index_copy(0, rows, sixd_from_matrix(batch.rotation[chosen]))
        score = teacher_logits(graspable(batch.kind))
    two = net.module_two(one.features, score.to(one.features.dtype), fed.to(one.features.dtype), batch.voxels)
    weight = batch.weight[chosen]
    offset = offset_loss(two.offset[rows], batch.offset[chosen], weight, weights.offset_epsilon)
    j_init = joint_loss(two.j_init[rows], batch.j_init[chosen], weight)
    j_end = joint_loss(two.j_end[rows], batch.j_end[chosen], weight)
    total = weights.score * gp + weights.rotation * rotation + weights.offset * offset
    total = total + weights.j_init * j_init + weights.j_end * j_end
    if one.hypothesis_logits.shape[1] > 1:
        total = total + weights.hypothesis * hypothesis
    with torch.no_grad():
        predicted = one.score_logits.argmax(1) > 0
        positive = graspable(batch.kind)
        hits = (predicted & positive).sum().item()
        terms = {
            "loss": total.item(),
            "score": gp.item(),
            "rotation": rotation.item(),
            "hypothesis": hypothesis.item(),
            "offset": offset.item(),
            "j_init": j_init.item(),
            "j_end": j_end.item(),
            "precision": hits / max(1, predicted.sum().item()),
            "recall": hits / max(1, positive.sum().item()),
            "angle_deg": float(torch.rad2deg(angle).median()) if len(angle) else math.nan,
            "offset_mm": float((two.offset[rows] - batch.offset[chosen]).norm(dim=1).median()) * 1e3
            if len(rows)
            else math.nan,
            "j_end_rad": float((two.j_end[rows] - batch.j_end[chosen]).abs().mean())
            if len(rows)
            else math.nan,
        }
    return total, terms


def label_settings(config: NetworkConfig) -> LabelSettings:
    """The paper's labels for the paper's network, denser supervision for the others."""
    paper = config.name == "paper"
    return LabelSettings(supervise_candidates=not paper, unknown_objects=not paper)


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
    ):
        torch.manual_seed(settings.seed)
        if settings.threads:
            torch.set_num_threads(settings.threads)
        self.config, self.source, self.folder, self.settings = config, source, folder, settings
        self.loss_weights = loss_weights or LossWeights()
        self.labels = labels or label_settings(config)
        self.augmentation = augmentation or Augmentation()
        self.net = DGSNet(config).to(settings.device)
        self.averaged = {k: v.detach().clone().float() for k, v in self.net.state_dict().items()}
        self.optimiser = torch.optim.AdamW(
            self.net.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.step = 0
        folder.mkdir(parents=True, exist_ok=True)

    @property
    def checkpoint(self) -> Path:
        """The file that a stopped run goes on from."""
        return self.folder / "checkpoint.pt"

    def save(self) -> None:
        """Write the checkpoint atomically, and the averaged weights beside it as a loadable model."""
        state = {
            "step": self.step,
            "net": self.net.state_dict(),
            "averaged": self.averaged,
            "optimiser": self.optimiser.state_dict(),
        }
        partial = self.checkpoint.with_suffix(".partial")
        torch.save(state, partial)
        partial.replace(self.checkpoint)
        self.export("latest")

    def export(self, name: str, folder: Path | None = None, notes: dict | None = None) -> None:
        """Write the averaged weights as `<name>.pt` and `<name>.json`."""
        net = DGSNet(self.config)
        net.load_state_dict({k: v.to(net.state_dict()[k].dtype) for k, v in self.averaged.items()})
        save_network(
            net,
            folder or self.folder,
            name,
            {"step": self.step, "training": asdict(self.settings), **(notes or {})},
        )

    def resume(self) -> bool:
        """Go on from the checkpoint if there is one."""
        if not self.checkpoint.exists():
            return False
        state = torch.load(self.checkpoint, map_location=self.settings.device, weights_only=True)
        self.net.load_state_dict(state["net"])
        self.averaged = state["averaged"]
        self.optimiser.load_state_dict(state["optimiser"])
        self.step = int(state["step"])
        return True

    def loader(self) -> DataLoader:
        """Batches from the present step on."""
        scenes = len(self.source.dataset.scenes) - self.settings.held_out_scenes
        return DataLoader(
            ViewDataset(self.source, self.augmentation, self.settings.seed),
            batch_sampler=Sampler(scenes, self.settings, self.step),
            collate_fn=Collator(self.config, self.labels, with_pairs=self.settings.device == "cpu"),
            num_workers=self.settings.workers,
            prefetch_factor=4 if self.settings.workers else None,
        )

    def train_step(self, batch: TrainingBatch) -> dict[str, float]:
        """One update."""
        self.net.train()
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.step, self.settings)
        device = self.settings.device
        with torch.autocast(device.split(":")[0], torch.bfloat16, enabled=device != "cpu"):
            total, terms = losses(self.net, batch.to(device), self.loss_weights, self.settings.teacher)
        self.optimiser.zero_grad(set_to_none=True)
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), self.settings.clip)
        self.optimiser.step()
        self.step += 1
        decay = min(self.settings.ema, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.net.state_dict().items():
                self.averaged[name].lerp_(value.float(), 1 - decay)
        return terms

    def run(self) -> None:
        """Train to the last step; print and log as it goes."""
        log = self.folder / "curve.csv"
        started = saved = time.monotonic()
        first, recent = self.step, []
        for batch in self.loader():
            recent.append(self.train_step(batch))
            if self.step % 10 == 0 or self.step == self.settings.steps:
                rate = (self.step - first) * self.settings.batch / (time.monotonic() - started)
                means = {k: float(np.nanmean([terms[k] for terms in recent])) for k in recent[0]}
                self._report(log, means, rate)
                recent = []
            if time.monotonic() - saved > 60 * self.settings.checkpoint_minutes:
                self.save()
                saved = time.monotonic()
        self.save()

    def _report(self, log: Path, means: dict[str, float], rate: float) -> None:
        left = (self.settings.steps - self.step) * self.settings.batch / max(rate, 1e-9)
        text = " ".join(f"{k} {v:.3g}" for k, v in means.items())
        print(
            f"step {self.step}/{self.settings.steps} {rate:.2f} samples/s left {left / 60:.0f} min  {text}",
            flush=True,
        )
        fresh = not log.exists()
        with log.open("a", newline="") as file:
            writer = csv.writer(file)
            if fresh:
                writer.writerow(["step", "samples_per_s", *means])
            writer.writerow([self.step, f"{rate:.4g}", *(f"{v:.6g}" for v in means.values())])

"""The training loop of the small U-Nets (depth completion, shape completion): resumable, on a core or a GPU."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from torch import Tensor

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.unet import UNet
from dgs_grasp_planner.runtime import cpu_has_bf16
from dgs_learning.training.checkpoint import read_checkpoint
from dgs_learning.training.finite_steps import FiniteSteps

Values = dict[str, float]
FREE = {"steps", "learning_rate", "device", "workers"}
"""Settings that may be others when a training goes on."""


@dataclass(frozen=True)
class FitSettings:
    """How long to train, and on what.

    Attributes:
        views: rendered views; held_out: the last of them, only measured on.
        steps: updates; batch: crops per step.
        learning_rate: its peak.
        seed: the same seed gives the same views and crops.
        device: `cpu` or `cuda`.
        workers: processes that render beside, where a training renders as it goes.
        start: file of weights to begin with; empty = they are drawn.
    """

    views: int
    held_out: int
    steps: int
    batch: int
    learning_rate: float = 3e-3
    seed: int = 0
    device: str = "cpu"
    workers: int = 1
    start: str = ""

    def scene_of(self, view: int, scenes: int) -> int:
        """Number of a view's scene among so many: those of the held-out views are the last ones, seen by no other.

        Raises:
            DgsError: REQUEST_INVALID: too few views or scenes to hold some out.
        """
        rest, late = scenes - self.held_out, view - self.views + self.held_out
        if rest < 1 or self.views <= self.held_out:
            few = f"{self.views} views of {scenes} scenes cannot be trained on"
            raise DgsError(ErrorCode.REQUEST_INVALID, f"{few}: {self.held_out} are held out")
        return rest + late if late >= 0 else view % rest


def fit(
    net: UNet,
    batches: Callable[[int], Callable[[int], Sequence[Tensor]]],
    loss: Callable[[Tensor, Tensor], Sequence[Tensor]],
    measure: Callable[[UNet], Values],
    settings: FitSettings,
    folder: Path,
    dataset: str,
) -> Values:
    """Train to the last step, or go on from the checkpoint in the folder.

    Args:
        net: is trained in place.
        batches: from a step on, gives what gives the batch of a step: features (N, inputs, h, w) and truth. Asked for
            when folder and weights to begin with are known to fit.
        loss: terms of the loss for what the network makes of the features, and the truth.
        measure: says what the network does on held-out samples.
        folder: of the checkpoint.
        dataset: hash of the one that the batches are made from.

    Returns:
        the last of `measure`.

    Raises:
        DgsError: WEIGHTS_MISSING: the weights to begin with are not there, or are others; REQUEST_INVALID: the
            checkpoint is damaged, of another dataset, or of other settings than those that are `FREE`; many gradients
            on end are not finite.
    """
    folder.mkdir(parents=True, exist_ok=True)
    steps = settings.steps
    device = torch.device(settings.device)
    halved = device.type == "cuda" or cpu_has_bf16()
    net.to(device, memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(net.parameters(), weight_decay=1e-2)
    checkpoint, step = folder / "checkpoint.pt", 0
    made_from = {name: value for name, value in asdict(settings).items() if name not in FREE}
    made_from["dataset"] = dataset
    if checkpoint.exists():
        state = read_checkpoint(checkpoint, device, made_from)
        net.load_state_dict(state["net"])
        optimiser.load_state_dict(state["optimiser"])
        step = int(state["step"])
    elif settings.start:
        net.loaded(Path(settings.start), ErrorCode.WEIGHTS_MISSING, "a training without --start")
    batch, taken = batches(step), FiniteSteps(optimiser)
    started, first, recent = time.monotonic(), step, []
    while step < steps:
        features, truth = (part.to(device) for part in batch(step))
        for group in optimiser.param_groups:
            group["lr"] = rate(step, steps, settings.learning_rate)
        net.train()
        with torch.autocast(device.type, torch.bfloat16, enabled=halved):
            out = net(features.to(memory_format=torch.channels_last))
        terms = torch.stack(tuple(loss(out.float(), truth)))
        optimiser.zero_grad(set_to_none=True)
        terms.sum().backward()
        taken.take(net.parameters(), step)
        step += 1
        recent.append(terms.detach())
        if step % 100 == 0 or step == steps:
            left = (time.monotonic() - started) / (step - first) * (steps - step) / 60
            means = " ".join(f"{value:.3f}" for value in torch.stack(recent).mean(dim=0).tolist())
            print(f"step {step}/{steps} left {left:.0f} min  loss {means}", flush=True)
            recent = []
            state = {"net": net.state_dict(), "optimiser": optimiser.state_dict(), "step": step}
            state["made_from"] = made_from
            with atomic_write(checkpoint) as file:
                torch.save(state, file)
        if step % 500 == 0 and step < steps:
            print(f"held out {_text(measure(net.cpu().eval()))}", flush=True)
            net.to(device)
    measured = measure(net.cpu().eval())
    print(f"held out {_text(measured)}", flush=True)
    return measured


def rate(step: int, steps: int, peak: float) -> float:
    """Learning rate of a step: up for a tenth of the steps, then a cosine down."""
    warm = max(1, steps // 10)
    if step < warm:
        return peak * (step + 1) / warm
    return 0.5 * peak * (1 + math.cos(math.pi * (step - warm) / max(1, steps - warm)))


def ship(
    net: UNet,
    file: Path,
    settings: FitSettings,
    measured: Values,
    title: str,
    words: str,
    rows: dict[str, str],
) -> Path:
    """Write the weights, and a model card of title, words and rows beside them; returns the file of the weights."""
    net.save(file, {**asdict(settings), **measured})
    rows = {
        "file": f"`{file.name}`, {file.stat().st_size / 1e6:.2f} MB, convolutions in 8 bits",
        "parameters": f"{sum(p.numel() for p in net.parameters()) / 1e6:.2f} M",
        **rows,
    }
    table = "\n".join(f"| {name} | {text} |" for name, text in rows.items())
    file.with_suffix(".md").write_text(
        f"# {title}\n\n{words}\n\n| | |\n|---|---|\n{table}\n", encoding="utf-8"
    )
    return file


def _text(values: Values) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())

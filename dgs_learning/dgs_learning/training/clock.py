"""Where the time of a training step goes: waiting for data, forward, backward, optimiser."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch

STAGES = ("data", "forward", "backward", "optimiser")
GPU_PERIOD = 10
"""On a GPU one step of so many is measured: measuring makes the host wait for the GPU."""


class StepClock:
    """Mean seconds per stage. `data` is the time that the loop waits for a batch; it is measured at every step."""

    def __init__(self, device: torch.device, timer: Callable[[], float] | None = None):
        """Measure on a device with a timer [s]; None = elapsed time."""
        self._timer = timer or time.perf_counter
        self._gpu = device.type == "cuda"
        self._device = device
        self._total = dict.fromkeys(STAGES, 0.0)
        self._count = dict.fromkeys(STAGES, 0)
        self._measured = True
        self._last = self._timer()

    def wait(self) -> None:
        """The loop begins to wait for a batch."""
        self._last = self._timer()

    def batch(self, step: int) -> None:
        """The batch is there, the step begins."""
        self._add("data", self._timer())
        self._measured = not self._gpu or step % GPU_PERIOD == 0
        if self._measured:
            self._last = self._now()

    def lap(self, stage: str) -> None:
        """Stage `stage` is over."""
        if self._measured:
            self._add(stage, self._now())

    def means(self) -> dict[str, float]:
        """`data_s`, `forward_s`, ... since the last call; NaN where nothing was measured."""
        out = {
            f"{name}_s": self._total[name] / self._count[name] if self._count[name] else float("nan")
            for name in STAGES
        }
        self._total, self._count = dict.fromkeys(STAGES, 0.0), dict.fromkeys(STAGES, 0)
        return out

    def _now(self) -> float:
        if self._gpu:
            torch.cuda.synchronize(self._device)
        return self._timer()

    def _add(self, stage: str, now: float) -> None:
        self._total[stage] += now - self._last
        self._count[stage] += 1
        self._last = now

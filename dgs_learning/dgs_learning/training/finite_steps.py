"""Keeps gradients that are not finite away from the weights."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn

from dgs_description.errors import DgsError, ErrorCode

MOST_GRADIENT = 1.0
"""Largest norm of the gradient."""
MOST_SKIPPED = 20
"""So many steps on end whose gradient is not finite end the training."""


class FiniteSteps:
    """An optimiser's steps; those whose gradient is not finite are left out, for one would spoil all weights.

    Attributes:
        skipped: steps on end that were left out.
    """

    def __init__(self, optimiser: torch.optim.Optimizer) -> None:
        self.optimiser, self.skipped = optimiser, 0

    def take(self, parameters: Iterable[Tensor], step: int) -> None:
        """Follow the gradient, at most `MOST_GRADIENT` of it.

        Raises:
            DgsError: REQUEST_INVALID, `MOST_SKIPPED` gradients on end are not finite.
        """
        if bool(torch.isfinite(nn.utils.clip_grad_norm_(parameters, MOST_GRADIENT))):
            self.skipped = 0
            self.optimiser.step()
            return
        self.skipped += 1
        print(f"step {step}: the gradient is not finite, left out", flush=True)
        if self.skipped >= MOST_SKIPPED:
            lower = f"{self.skipped} gradients on end are not finite: go on with a lower learning rate"
            raise DgsError(ErrorCode.REQUEST_INVALID, f"step {step}: {lower}")

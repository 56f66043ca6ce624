"""A small U-Net for images, and its weights file: one form for every network that fills in what a camera misses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write

_SCALE = ".scale"
"""Ends the name of what 8-bit weights are to be multiplied by, (N, 1, 1, 1) per output channel."""


class UNet(nn.Module):
    """(N, inputs, h, w) -> (N, outputs, h, w), both even: the first level works on half of the resolution."""

    def __init__(self, inputs: int, outputs: int, widths: Sequence[int]) -> None:
        """`widths`: channels per level; every level has half of the resolution of the one before."""
        super().__init__()
        down = (4 * inputs, *widths)
        self.down = nn.ModuleList(_block(a, b) for a, b in zip(down, widths, strict=False))
        up = list(zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.up = nn.ModuleList(_layer(a + b, b) for a, b in up)
        self.head = nn.Conv2d(widths[0], 4 * outputs, 1)
        self.fold, self.unfold, self.pool = nn.PixelUnshuffle(2), nn.PixelShuffle(2), nn.MaxPool2d(2)

    def forward(self, x: Tensor) -> Tensor:
        """What it makes of a batch of images."""
        x, skipped = self.fold(x), []
        for k, block in enumerate(self.down):
            x = block(self.pool(x) if k else x)
            skipped.append(x)
        for layer, skip in zip(self.up, skipped[-2::-1], strict=True):
            x = layer(torch.cat([interpolate(x, skip.shape[-2:]), skip], dim=1))
        return self.unfold(self.head(x))

    def save(self, file: Path, notes: dict[str, Any]) -> None:
        """Write the weights, those of convolutions in 8 bits per number, and notes (numbers and words)."""
        state = {}
        for key, value in self.state_dict().items():
            if value.dim() == 4:
                scale = value.abs().amax(dim=(1, 2, 3), keepdim=True).clamp(min=1e-12) / 127
                state[key], state[key + _SCALE] = (value / scale).round().to(torch.int8), scale
            else:
                state[key] = value
        with atomic_write(file) as out:
            torch.save({"weights": state, "notes": notes}, out)

    def loaded(self, file: Path, code: ErrorCode, command: str) -> UNet:
        """Take the weights of a file; returns itself, ready for use.

        Raises:
            DgsError: `code`: the file is missing (make it with `command`) or holds something else.
        """
        try:
            state = torch.load(file, map_location="cpu", weights_only=True)["weights"]
            for key in [key for key in state if key.endswith(_SCALE)]:
                state[key.removesuffix(_SCALE)] = state[key.removesuffix(_SCALE)] * state.pop(key)
            self.load_state_dict(state)
        except FileNotFoundError as error:
            raise DgsError(code, f"there are no weights at {file}: make them with `{command}`") from error
        except Exception as error:  # torch raises many kinds here; all mean the same to the user
            raise DgsError(code, f"{file} holds other weights ({error}): fetch or make it again") from error
        return self.eval().to(memory_format=torch.channels_last)


def _layer(a: int, b: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(a, b, 3, padding=1, bias=False), nn.BatchNorm2d(b), nn.ReLU(inplace=True))


def _block(a: int, b: int) -> nn.Sequential:
    return nn.Sequential(_layer(a, b), _layer(b, b))

"""Writes frames to an animated GIF that stays below a size limit. No ROS."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

MAX_BYTES = 8_000_000
MAX_FRAMES = 240
FRAME_TIME = 0.12
"""Time per frame in the animation [s]: runs are shown several times faster than they were."""


def write_gif(path: Path, frames: Sequence[NDArray[np.uint8]], max_bytes: int = MAX_BYTES) -> int:
    """Write frames (H, W, 3) uint8, fewer, evenly, until the file is small enough; how many. No frames, no file."""
    count = min(len(frames), MAX_FRAMES)
    while count:
        data = _encode([frames[k] for k in np.linspace(0, len(frames) - 1, count).round().astype(int)])
        if len(data) <= max_bytes or count == 1:
            path.write_bytes(data)
            break
        # Two per cent less than the rule of three says: the first frame costs more than the others.
        count = max(1, int(0.98 * count * max_bytes / len(data)))
    return count


def _encode(frames: Sequence[NDArray[np.uint8]]) -> bytes:
    # One palette for all frames, taken from a few of them: colours do not flicker, and unchanged pixels compress.
    sample = np.concatenate([frames[k] for k in np.linspace(0, len(frames) - 1, 4).astype(int)], axis=0)
    shared = Image.fromarray(sample).quantize(256, method=Image.Quantize.MEDIANCUT)
    first, *others = [
        Image.fromarray(frame).quantize(palette=shared, dither=Image.Dither.NONE) for frame in frames
    ]
    buffer, duration = io.BytesIO(), int(1000 * FRAME_TIME)
    first.save(buffer, "GIF", save_all=True, append_images=others, duration=duration, loop=0, optimize=False)
    return buffer.getvalue()

"""The animation stays below its size limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from dgs_bringup.animation import MAX_FRAMES, write_gif


def frames(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (60, 80, 3), dtype=np.uint8) for _ in range(count)]


def test_frames_can_be_read_back(tmp_path: Path):
    assert write_gif(tmp_path / "run.gif", frames(5)) == 5
    with Image.open(tmp_path / "run.gif") as image:
        assert (image.n_frames, image.size) == (5, (80, 60))


def test_frames_are_left_out_until_the_file_is_small_enough(tmp_path: Path):
    kept = write_gif(tmp_path / "run.gif", frames(40), max_bytes=60_000)
    assert 2 <= kept < 40
    assert (tmp_path / "run.gif").stat().st_size <= 60_000
    assert write_gif(tmp_path / "run.gif", frames(3), max_bytes=10) == 1, "one at least"


def test_very_long_runs_are_thinned_out(tmp_path: Path):
    assert write_gif(tmp_path / "run.gif", [np.zeros((4, 4, 3), np.uint8)] * (MAX_FRAMES + 50)) <= MAX_FRAMES


def test_without_frames_there_is_no_file(tmp_path: Path):
    assert write_gif(tmp_path / "run.gif", []) == 0
    assert not (tmp_path / "run.gif").exists()

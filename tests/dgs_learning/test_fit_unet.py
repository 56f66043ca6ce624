"""The training loop of the small U-Nets: it learns, goes on where it stopped, and keeps what was made."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from dgs_description.unet import UNet
from dgs_learning.training.fit_unet import fit, kept, rate


def _batch(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the picture is bright."""
    x = np.random.default_rng(step).random((4, 1, 16, 16), dtype=np.float32)
    return x, (x > 0.5).astype(np.float32)


def _loss(out: Tensor, truth: Tensor) -> tuple[Tensor]:
    return (torch.nn.functional.binary_cross_entropy_with_logits(out, truth),)


def _measure(net: UNet) -> dict[str, float]:
    x, truth = (torch.from_numpy(part) for part in _batch(10**6))
    with torch.inference_mode():
        return {"right": float(((net(x) > 0) == (truth > 0)).float().mean())}


def test_it_learns_and_goes_on_to_the_same_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(0)
    whole = UNet(1, 1, (8, 8))
    start = {key: value.clone() for key, value in whole.state_dict().items()}
    measured = fit(whole, _batch, _loss, _measure, 60, 0.02, tmp_path)
    assert measured["right"] > 0.7, "half by chance"
    assert "step 60/60" in capsys.readouterr().out
    again = UNet(1, 1, (8, 8))
    again.load_state_dict(start)
    assert fit(again, _batch, _loss, _measure, 60, 0.02, tmp_path) == measured, (
        "from the checkpoint, no step left"
    )


def test_the_rate_rises_and_falls() -> None:
    rates = [rate(step, 100, 1.0) for step in range(100)]
    assert max(rates) == pytest.approx(1.0) and rates[0] < 0.2 and rates[-1] < 0.01


def test_what_was_made_is_kept(tmp_path: Path) -> None:
    made = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"a": np.arange(3)}

    for _ in range(2):
        np.testing.assert_array_equal(kept(tmp_path / "sub/a.npz", make)["a"], np.arange(3))
    assert len(made) == 1

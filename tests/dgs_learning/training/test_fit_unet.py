"""The training loop of the small U-Nets: it learns, goes on where it stopped, and keeps what was made."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from dgs_description.errors import ErrorCode
from dgs_description.unet import UNet
from dgs_learning.training.fit_unet import FitSettings, fit, rate
from tests.support.refused import refused

SETTINGS = FitSettings(views=0, held_out=0, steps=160, batch=4, learning_rate=0.02)


def _batch(step: int) -> tuple[Tensor, Tensor]:
    """Where the picture is bright."""
    x = torch.from_numpy(np.random.default_rng(step).random((4, 1, 16, 16), dtype=np.float32))
    return x, (x > 0.5).float()


def _loss(out: Tensor, truth: Tensor) -> tuple[Tensor]:
    return (torch.nn.functional.binary_cross_entropy_with_logits(out, truth),)


def _measure(net: UNet) -> dict[str, float]:
    x, truth = _batch(10**6)
    with torch.inference_mode():
        return {"right": float(((net(x) > 0) == (truth > 0)).float().mean())}


class Killed(Exception):
    """In place of a kill."""


def test_it_learns_and_a_run_cut_short_ends_with_the_same_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.manual_seed(0)
    start = UNet(1, 1, (8, 8)).state_dict()

    def net() -> UNet:
        fresh = UNet(1, 1, (8, 8))
        fresh.load_state_dict(start)
        return fresh

    def cut_short(step: int) -> tuple[Tensor, Tensor]:
        if step == 130:
            raise Killed
        return _batch(step)

    whole = net()
    assert fit(whole, lambda _: _batch, _loss, _measure, SETTINGS, tmp_path / "whole", "")["right"] > 0.7, (
        "half by chance"
    )
    assert "step 160/160" in capsys.readouterr().out
    with pytest.raises(Killed):
        fit(net(), lambda _: cut_short, _loss, _measure, SETTINGS, tmp_path / "parts", "")
    again = net()
    fit(again, lambda _: _batch, _loss, _measure, SETTINGS, tmp_path / "parts", "")
    for one, other in zip(whole.state_dict().values(), again.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_a_checkpoint_of_another_training_is_refused(tmp_path: Path) -> None:
    def run(dataset: str = "a", **others: int | str) -> None:
        settings = replace(SETTINGS, **({"steps": 1} | others))  # type: ignore[arg-type]
        fit(UNet(1, 1, (8, 8)), lambda _: _batch, _loss, _measure, settings, tmp_path, dataset)

    run()
    run(steps=2, workers=3)
    for wish in ({"dataset": "b"}, {"seed": 1}, {"batch": 8}, {"views": 100}):
        with refused(ErrorCode.REQUEST_INVALID, "is of another training"):
            run(**wish)  # type: ignore[arg-type]
    state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
    del state["made_from"]  # as an older program wrote it
    torch.save(state, tmp_path / "checkpoint.pt")
    run(seed=1, steps=3)


def test_the_rate_rises_and_falls() -> None:
    rates = [rate(step, 100, 1.0) for step in range(100)]
    assert max(rates) == pytest.approx(1.0) and rates[0] < 0.2 and rates[-1] < 0.01


def test_losses_that_are_not_finite_end_a_training_and_not_its_weights(tmp_path: Path) -> None:
    def spoilt(out: Tensor, truth: Tensor) -> tuple[Tensor]:
        return (_loss(out, truth)[0] * torch.nan,)

    torch.manual_seed(0)
    net = UNet(1, 1, (8, 8))
    before = {name: value.clone() for name, value in net.named_parameters()}
    with refused(ErrorCode.REQUEST_INVALID, "20 gradients on end are not finite"):
        fit(net, lambda _: _batch, spoilt, _measure, SETTINGS, tmp_path, "")
    assert all(torch.equal(value, before[name]) for name, value in net.named_parameters())

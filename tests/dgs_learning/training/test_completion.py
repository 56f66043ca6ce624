"""Training of the depth completion: its samples, its loss, and that it goes on where it stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_learning.training import completion
from dgs_learning.training.completion import (
    Sample,
    crops,
    loss_terms,
    measure,
    render_sample,
    ship_network,
    train,
)
from dgs_learning.training.fit_unet import FitSettings
from dgs_perception.completion import SCALE, DepthCompletion
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.refused import refused

DATA = tiny_dataset()
SMALL = FitSettings(views=4, held_out=1, steps=3, batch=2)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return [render_sample(DATA, k, SMALL) for k in range(3)]


def test_a_sample_shows_where_glass_is_and_how_high(samples: list[Sample]) -> None:
    again = render_sample(DATA, 1, SMALL)
    np.testing.assert_array_equal(samples[1].features, again.features)
    clear = np.concatenate([one.truth[0][np.isfinite(one.truth[1])] > 0 for one in samples])
    high = np.concatenate([one.truth[1][np.isfinite(one.truth[1])] for one in samples]) / SCALE
    assert 0 < clear.mean() < 0.2
    assert np.median(high[clear]) > 0.01 > abs(np.median(high[~clear]))


def test_the_loss_is_least_for_the_truth(samples: list[Sample]) -> None:
    truth = crops(samples, SMALL, 0)[1]
    sure = torch.full_like(truth[:, 0], -3.0)
    right = torch.stack([20 * truth[:, 0] - 10, truth[:, 1].nan_to_num(), sure], dim=1)
    wrong = right.clone()
    wrong[:, 1] += 0.5
    assert loss_terms(right, truth)[0] < 1e-3
    assert loss_terms(right, truth)[1] < loss_terms(wrong, truth)[1] - 5.0


def test_a_perfect_network_is_measured_as_one(samples: list[Sample]) -> None:
    class Perfect(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            truth = next(one.truth for one in samples if one.features.shape == x.shape[1:] and (
                one.features == x[0].numpy().astype(np.float16)).all())  # fmt: skip
            clear, r = torch.from_numpy(truth.astype(np.float32))
            return torch.stack([clear - 0.5, r, r])[None]

    assert any((one.truth[0] > 0).any() for one in samples)
    measured = measure(Perfect(), samples)  # type: ignore[arg-type]
    assert measured["mask_iou"] == 1.0 and measured["median_error_mm"] == 0.0
    assert measured["raw_median_error_mm"] > 3


def test_training_goes_on_and_ships(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(DATA, tmp_path, SMALL)
    rendered = {file: file.stat().st_mtime_ns for file in (tmp_path / "views").glob("*.npz")}
    net, measured = train(DATA, tmp_path, replace(SMALL, steps=5))
    assert "step 5/5" in capsys.readouterr().out
    assert len(rendered) == 4 and rendered == {file: file.stat().st_mtime_ns for file in rendered}
    assert int(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"]) == 5
    file = ship_network(net, measured, SMALL, tmp_path / "models")
    x = torch.rand(1, 4, 32, 48)
    with torch.inference_mode():
        torch.testing.assert_close(DepthCompletion(file).net(x), net.eval()(x), atol=2e-2, rtol=2e-2)
    assert "IoU" in file.with_suffix(".md").read_text()
    assert file.stat().st_size < 2e6


def test_held_out_views_are_of_scenes_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[list[np.ndarray]] = []

    def note(stage: Stage, *rest: Any, **keywords: Any) -> Shot:
        shown.append([np.asarray(pose) for pose in stage.poses[:2]])
        return take_shot(stage, *rest, **keywords)

    monkeypatch.setattr(completion, "take_shot", note)
    last = replace(DATA.scenes[-1], T_table_object=DATA.scenes[-1].T_table_object[::-1])
    data = replace(DATA, scenes=[*DATA.scenes[:-1], last])
    for number in range(SMALL.views):
        render_sample(data, number, SMALL)
    of_last = [bool((np.array(poses) == last.T_table_object).all()) for poses in shown]
    assert of_last == [False, False, False, True]


def test_views_of_another_dataset_are_refused(tmp_path: Path) -> None:
    train(DATA, tmp_path, replace(SMALL, steps=1))
    with refused(ErrorCode.REQUEST_INVALID, "files of another dataset"):
        train(tiny_dataset(4), tmp_path, replace(SMALL, steps=1))
    with refused(ErrorCode.REQUEST_INVALID, "checkpoint.pt is of another training"):
        train(DATA, tmp_path, replace(SMALL, seed=1))
    assert not list((tmp_path / "views").glob("seed1*")), "it is refused before the views are rendered"

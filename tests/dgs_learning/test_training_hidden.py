"""Training of the hidden sides: what its samples say, its loss, and that it ships."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_grasp_planner.contact.height_field import seen_heights
from dgs_grasp_planner.contact.hidden import REACH, HiddenSides, answer
from dgs_grasp_planner.contact.things import CELL
from dgs_learning.training.fit_unet import FitSettings
from dgs_learning.training.hidden import (
    VIEWS,
    Sample,
    crops,
    loss_terms,
    measure,
    render_sample,
    scene_and_turn,
    ship_network,
    train,
    true_heights,
)
from dgs_learning.training.views import capture
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.raster import box_mesh
from tests.dgs_learning.tiny_dataset import tiny_dataset

DATA = tiny_dataset()
SMALL = FitSettings(views=4, held_out=1, steps=2, batch=2)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    made = (render_sample(DATA, *scene_and_turn(DATA, k, SMALL), SMALL.seed) for k in range(4))
    return [one for one in made if one is not None]


def test_held_out_views_have_scenes_of_their_own() -> None:
    settings = replace(SMALL, views=20, held_out=1)
    assert len(DATA.scenes) > 1
    shown = [scene_and_turn(DATA, k, settings) for k in range(20)]
    assert len(set(shown)) == 20
    assert shown[-1][0] not in {scene for scene, _ in shown[:-1]}


def test_too_few_scenes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DgsError, match="held out") as refused:
        train(DATA, tmp_path, replace(SMALL, held_out=len(DATA.scenes)))
    assert refused.value.code == ErrorCode.REQUEST_INVALID


def test_the_truth_is_the_highest_point_of_every_cell() -> None:
    box, low = box_mesh((0.1, 0.0, 0.0), (0.2, 0.03, 0.05)), np.array([-0.1, -0.1])
    heights = true_heights([box], [np.eye(4)], (150, 100), low)
    places = low + (np.argwhere(heights > 0) + 0.5) * CELL
    np.testing.assert_allclose(places.min(axis=0), (0.1, 0.0), atol=CELL)
    np.testing.assert_allclose(places.max(axis=0), (0.2, 0.03), atol=CELL)
    assert heights.max() == pytest.approx(0.05, abs=1e-3)


def test_something_stands_where_a_thing_hides_itself(samples: list[Sample]) -> None:
    again = render_sample(DATA, *scene_and_turn(DATA, 1, SMALL), SMALL.seed)
    assert again is not None
    np.testing.assert_array_equal(samples[1].features, again.features)
    hidden = np.concatenate([one.truth[0][np.isfinite(one.truth[0])] for one in samples])
    assert 0.02 < hidden.mean() < 0.6, "some of the shadow is thing, the most is table"
    for one in samples:
        stands = one.truth[0] == 1
        assert (one.truth[1][stands] > one.features[0][stands]).all(), "higher than what was seen there"


def test_the_loss_is_least_for_the_truth(samples: list[Sample]) -> None:
    features, truth = (torch.from_numpy(part) for part in crops(samples, SMALL, 0))
    assert features.shape[:2] == (2, 6) and torch.isfinite(truth[:, 0]).any()
    right = torch.stack([20 * truth[:, 0].nan_to_num() - 10, truth[:, 1].nan_to_num()], dim=1)
    assert all(term < 1e-3 for term in loss_terms(right, truth))
    wrong = right + torch.tensor([0.0, 0.5])[None, :, None, None]
    assert loss_terms(wrong, truth)[1] == pytest.approx(0.5, abs=1e-3)
    assert loss_terms(right * torch.tensor([-1.0, 1.0])[None, :, None, None], truth)[0] > 5


def test_a_crop_that_is_turned_tells_the_camera_s_direction_too(samples: list[Sample]) -> None:
    """Along the direction to the camera the shadow's height rises towards what throws it."""
    for step in range(6):
        features, truth = crops(samples, SMALL, step)
        for shown, where in zip(features, np.isfinite(truth[:, 0]), strict=True):
            gx, gy = np.gradient(shown[2])
            inside = where & (np.hypot(gx, gy) < 0.1)
            assert np.median((gx * shown[3] + gy * shown[4])[inside]) > 0


def test_a_perfect_network_is_measured_as_one(samples: list[Sample]) -> None:
    class Perfect(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            out = torch.zeros(1, 2, *x.shape[2:])
            for one in samples:
                width, depth = one.truth.shape[1:]
                here = x[0, :, :width, :depth].numpy().astype(np.float16)
                if np.array_equal(one.features, here):
                    known = torch.from_numpy(np.nan_to_num(one.truth.astype(np.float32)))
                    out[0, :, :width, :depth] = known - torch.tensor([0.5, 0.0])[:, None, None]
            return out

    measured = measure(Perfect(), samples)  # type: ignore[arg-type]
    assert measured["iou"] == 1.0 and measured["median_error_mm"] == 0.0


def test_training_goes_on_and_ships(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(DATA, tmp_path, SMALL)
    net, measured = train(DATA, tmp_path, replace(SMALL, steps=3))
    assert "step 3/3" in capsys.readouterr().out
    file = ship_network(net, measured, SMALL, tmp_path / "models")
    features = np.random.default_rng(0).random((6, 40, 51), dtype=np.float32)
    for shipped, trained in zip(answer(HiddenSides(file).net, features), answer(net, features), strict=True):
        np.testing.assert_allclose(shipped, trained, atol=2e-2)
    assert int(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"]) == 3
    assert "IoU" in file.with_suffix(".md").read_text() and file.stat().st_size < 1e6


@pytest.mark.parametrize("elevation_deg", [15.0, 40.0])
def test_what_ships_finds_hidden_sides_of_things_it_has_never_seen(elevation_deg: float) -> None:
    models = [find_catalogue("novel")[k] for k in (0, 20, 40, 60)]
    places = [(-0.12, -0.12), (-0.12, 0.12), (0.12, -0.12), (0.12, 0.12)]
    poses = [
        transform(position=(x, y, -model.vertices[:, 2].min()))
        for model, (x, y) in zip(models, places, strict=True)
    ]
    elevation = np.deg2rad(elevation_deg)
    view = capture(models, poses, np.random.default_rng(0), replace(VIEWS, elevation=(elevation, elevation)))
    seen_heights_, owner, low = seen_heights(view.points, REACH) or pytest.fail("nothing was seen")
    filled = seen_heights_.copy()
    HiddenSides()(filled, owner, view.camera, low)
    meshes = [model.mesh for model in models]
    true = true_heights(meshes, poses, filled.shape, low)
    made, unseen = filled > seen_heights_, true > np.maximum(seen_heights_, 0.01)
    assert made.sum() > 100
    assert (true[made] > 0.005).mean() > 0.6, "most of what it makes is there"
    assert np.abs(filled - true)[made & (true > 0.005)].mean() < 0.015
    assert (made & unseen).sum() > 0.3 * unseen.sum(), "and it finds a good part of what is hidden"

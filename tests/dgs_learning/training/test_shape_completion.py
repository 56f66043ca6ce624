"""Training of the shape completion: what its samples say, its loss, and that it ships."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_description.frames import transform
from dgs_grasp_planner.contact.shape_completion import INPUTS, SCALE, answer, loaded_net, seen
from dgs_grasp_planner.contact.shape_completion import shape_completion as shipped_net
from dgs_grasp_planner.contact.things import CELL
from dgs_learning.training import shape_completion
from dgs_learning.training.fit_unet import FitSettings
from dgs_learning.training.shape_completion import (
    CROP,
    LEAST,
    MOST,
    PER_VIEW,
    VIEWS,
    Pool,
    Sample,
    Views,
    changed,
    loss_terms,
    measure,
    meshes_of,
    render_sample,
    ship_network,
    train,
    truth,
    turned,
)
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.raster import box_mesh
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.refused import refused

DATA = tiny_dataset()
SMALL = FitSettings(views=6, held_out=1, steps=2, batch=8, workers=0)


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    made = (Views(DATA, SMALL).sample(number) for number in range(6))
    return [one for one in made if one is not None]


def test_held_out_views_are_of_scenes_of_their_own_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[list[np.ndarray]] = []
    monkeypatch.setattr(
        shape_completion, "render_sample", lambda meshes, *_: shown.append([m[0] for m in meshes])
    )
    last = replace(
        DATA.scenes[-1], T_table_object=DATA.scenes[-1].T_table_object @ transform(position=(0.2, 0, 0))
    )
    views = Views(replace(DATA, scenes=[*DATA.scenes[:-1], last]), replace(SMALL, views=20))
    for number in range(20):
        views.sample(number)
    own = meshes_of([DATA.objects[k] for k in last.objects], last.T_table_object)
    for drawn, (vertices, _) in zip(shown[-1], own, strict=True):
        np.testing.assert_array_equal(drawn, vertices)
    before = np.concatenate([vertices for drawn in shown[:-1] for vertices in drawn])
    assert before[:, 0].max() < 0.2 < np.concatenate([vertices for vertices, _ in own])[:, 0].max()


def test_too_few_scenes_are_refused(tmp_path: Path) -> None:
    with refused(ErrorCode.REQUEST_INVALID, "held out"):
        train(DATA, tmp_path, replace(SMALL, held_out=len(DATA.scenes)))


def test_weights_that_are_missing_are_refused_before_a_view_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shape_completion, "render_sample", None)
    with refused(ErrorCode.WEIGHTS_MISSING, "none.pt"):
        train(DATA, tmp_path, replace(SMALL, start=str(tmp_path / "none.pt")))


def test_the_truth_of_two_boxes() -> None:
    left, right = (
        box_mesh((0.0, 0.0, 0.0), (0.06, 0.06, 0.05)),
        box_mesh((0.06, 0.0, 0.0), (0.12, 0.06, 0.03)),
    )
    low = np.array([-0.1, -0.1])
    heights, way_x, way_y, border = truth([left, right], (100, 90), low)
    x, y = (low[:, None, None] + (np.indices(heights.shape) + 0.5) * CELL).round(6)
    np.testing.assert_allclose([x[heights > 0].min(), x[heights > 0].max()], (0.0, 0.12), atol=CELL)
    assert heights[x < 0.055].max() == pytest.approx(0.05 * SCALE, abs=0.01)
    assert heights[x > 0.065].max() == pytest.approx(0.03 * SCALE, abs=0.01)
    inside = (heights > 0) & (abs(x - 0.06) > 2 * CELL)
    middle = np.where(x < 0.06, 0.03, 0.09)
    np.testing.assert_allclose((x + way_x / SCALE)[inside], middle[inside], atol=CELL)
    np.testing.assert_allclose((y + way_y / SCALE)[inside], 0.03, atol=CELL)
    assert (border[(heights > 0) & (abs(x - 0.06) < CELL)] == 1).all() and not border[
        abs(x - 0.06) > 4 * CELL
    ].any()


def test_views_are_the_same_again_and_something_is_hidden(samples: list[Sample]) -> None:
    again = Views(DATA, SMALL).sample(1)
    assert again is not None
    np.testing.assert_array_equal(samples[1].features, again.features)
    hidden = np.concatenate([one.truth[0][(one.truth[4] > 0) & (one.features[1] == 0)] for one in samples])
    assert 0.02 < (hidden > 0).mean() < 0.6, "some of the shadow is thing, the most is table"


def test_things_are_left_out_stretched_and_moved_but_stay_on_the_table() -> None:
    boxes = [box_mesh((x, -0.03, 0.0), (x + 0.05, 0.03, 0.08)) for x in (-0.2, -0.05, 0.1)]
    counts, heights, gaps, boards = set(), [], [], []
    for seed in range(40):
        out = changed(boxes, np.random.default_rng(seed))
        counts.add(len(out))
        for vertices, _ in out:
            assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
            heights.append(vertices[:, 2].max())
        boards += [
            np.ptp(v, axis=0) for v, _ in out if np.ptp(v[:, 0]) > 1.3 * 0.05 and v[:, 2].max() < 0.6 * 0.08
        ]
        ends = sorted((vertices[:, 0].min(), vertices[:, 0].max()) for vertices, _ in out)
        gaps += [later - before for (_, before), (later, _) in zip(ends, ends[1:], strict=False)]
    assert {2, 3} <= counts and min(heights) < 0.06 and max(heights) > 0.1
    assert boards and min(board[2] for board in boards) > LEAST - 1e-6
    assert max(board[:2].max() for board in boards) < MOST * 1.5
    assert min(gaps) > -0.006 and (np.array(gaps) < 0.006).mean() > 0.2, (
        "pushed together, not into each other"
    )


def test_the_loss_is_least_for_the_truth() -> None:
    squares = Views(DATA, SMALL)[0].float()
    assert squares.shape == (PER_VIEW, INPUTS + 5, CROP, CROP)
    true = squares[:, INPUTS:]
    logits = [20 * (part > 0).float() - 10 for part in (true[:, 0], true[:, 3])]
    right = torch.stack([logits[0], true[:, 0], true[:, 1], true[:, 2], logits[1]], dim=1)
    assert all(term < 1e-3 for term in loss_terms(right, true))
    for channel, term in ((1, 1), (2, 2), (3, 2)):
        wrong = right.clone()
        wrong[:, channel] += 0.5
        assert loss_terms(wrong, true)[term] == pytest.approx(0.5 if term == 1 else 0.25, abs=1e-2)
    for channel, term in ((0, 0), (4, 3)):
        wrong = right.clone()
        wrong[:, channel] *= -1
        assert loss_terms(wrong, true)[term] > 1


@pytest.mark.parametrize("k", range(8))
def test_a_square_that_is_turned_tells_the_camera_s_direction_and_the_middle_too(k: int) -> None:
    """The features of a turned scene are the turned features."""
    low, size = np.array([-0.064 * 3, -0.064 * 3]), (CROP, CROP)
    box = box_mesh((0.02, -0.05, 0.0), (0.09, 0.03, 0.05))
    camera = np.array([0.5, 0.3, 0.6])

    def square(flip: tuple[float, float], exchange: bool) -> torch.Tensor:
        vertices, faces = box
        turn = np.diag([*flip, 1.0])
        if exchange:
            turn = turn[[1, 0, 2]]
        made = truth([(vertices @ turn.T, faces[:, ::-1] if np.linalg.det(turn) < 0 else faces)], size, low)
        heights = np.where(made[0] > 0, made[0] / SCALE, -1.0).astype(np.float32)
        empty = np.zeros((0, 3), np.float32)
        features = seen(heights, empty, empty, turn @ camera, low).features
        return torch.from_numpy(np.concatenate([features, made, made[:1]]))[None]

    flip = (-1.0 if k & 1 else 1.0, -1.0 if k & 2 else 1.0)
    made, wanted = turned(square((1.0, 1.0), False), k), square(flip, bool(k & 4))
    away = (made - wanted).abs()
    assert np.percentile(away.numpy(), 97) < 0.02


def test_a_pool_gives_every_view_in_time_and_the_same_batch_again() -> None:
    pool, again = (Pool(Views(DATA, SMALL), 0) for _ in range(2))
    for step in range(2):
        features, true = pool(step)
        assert features.shape == (8, INPUTS, CROP, CROP) and true.shape == (8, 5, CROP, CROP)
        np.testing.assert_array_equal(features.numpy(), again(step)[0].numpy())
    assert pool.seen == SMALL.views - SMALL.held_out


def test_a_perfect_network_is_measured_as_one(samples: list[Sample]) -> None:
    class Perfect(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            out = torch.zeros(1, 5, *x.shape[2:])
            for one in samples:
                width, depth = one.truth.shape[1:]
                if np.array_equal(one.features, x[0, :, :width, :depth].numpy()):
                    true = torch.from_numpy(one.truth)
                    out[0, 0] = -10
                    out[0, :2, :width, :depth] = torch.stack([20 * (true[0] > 0.005 * SCALE) - 10, true[0]])
            return out

    measured = measure(Perfect(), samples)  # type: ignore[arg-type]
    assert measured["iou"] == measured["found"] == measured["right"] == 1.0
    assert measured["median_error_mm"] == pytest.approx(0.0, abs=1e-3) and measured["seen_iou"] < 1.0


def test_training_goes_on_and_ships(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    train(DATA, tmp_path, SMALL)
    net, measured = train(DATA, tmp_path, replace(SMALL, steps=3))
    assert "step 3/3" in capsys.readouterr().out
    file = ship_network(net, measured, SMALL, tmp_path / "models")
    features = np.random.default_rng(0).random((INPUTS, 40, 51), dtype=np.float32)
    shipped, trained = answer(loaded_net(file), features), answer(net, features)
    np.testing.assert_allclose(shipped.chance, trained.chance, atol=2e-2)
    np.testing.assert_allclose(shipped.height, trained.height, atol=5e-3)
    assert int(torch.load(tmp_path / "checkpoint.pt", weights_only=True)["step"]) == 3
    still = replace(SMALL, steps=1, learning_rate=0.0, start=str(file))
    begun, _ = train(DATA, tmp_path / "begun", still)
    np.testing.assert_allclose(answer(begun, features).chance, shipped.chance, atol=5e-2)
    assert "IoU" in file.with_suffix(".md").read_text() and file.stat().st_size < 3e6


@pytest.mark.parametrize("elevation_deg", [15.0, 40.0])
def test_what_ships_completes_things_it_has_never_seen(elevation_deg: float) -> None:
    models = [find_catalogue("novel")[k] for k in (0, 20, 40, 60)]
    places = [(-0.12, -0.12), (-0.12, 0.12), (0.12, -0.12), (0.12, 0.12)]
    poses = [
        transform(position=(x, y, -model.vertices[:, 2].min()))
        for model, (x, y) in zip(models, places, strict=True)
    ]
    elevation = np.deg2rad(elevation_deg)
    views = replace(VIEWS, elevation=(elevation, elevation), distance=(0.9, 0.9))
    one = render_sample(meshes_of(models, poses), np.random.default_rng(0), views)
    assert one is not None
    measured = measure(shipped_net(), [one])
    assert measured["found"] > 0.6 and measured["right"] > 0.7
    assert measured["iou"] > measured["seen_iou"] + 0.1 and measured["iou"] > 0.7
    assert measured["median_error_mm"] < 6

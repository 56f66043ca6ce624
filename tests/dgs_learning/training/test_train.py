"""Labels, losses and the training loop."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.network import PRESETS
from dgs_grasp_planner.network.rotation import sixd_from_matrix
from dgs_learning.dataset import (
    GUIDED,
    GraspDataset,
    finger_pattern,
    object_grasps,
)
from dgs_learning.training import batches, train
from dgs_learning.training.batches import ViewDataset, augment
from dgs_learning.training.curve import read_curve
from dgs_learning.training.labels import (
    AIR_SHARE,
    CANDIDATE,
    CANDIDATE_WEIGHT,
    NOT_GRASPABLE,
    REFERENCE,
    Labels,
    label,
    typical_shapes,
)
from dgs_learning.training.losses import (
    Objective,
    joint_loss,
    offset_loss,
    readable_errors,
    rotation_errors,
    rotation_loss,
    score_loss,
)
from dgs_learning.training.settings import TrainingSettings
from dgs_learning.training.train import Trainer
from dgs_learning.training.views import ViewSource
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.refused import refused


@pytest.fixture(scope="module")
def dataset() -> GraspDataset:
    return tiny_dataset()


def _grid() -> np.ndarray:
    x, y = np.meshgrid(np.arange(10) * 0.01, np.arange(10) * 0.01)
    return np.column_stack([x.ravel(), y.ravel(), np.full(100, 0.05)])


def _grasp_at(position: list[float]) -> GraspSet:
    joints = np.tile([0.0, 0.5, 0.4, 0.4], 5)[None]
    return object_grasps([position], np.eye(3), joints, finger_pattern([5]), np.array([GUIDED]))


def test_labels_mark_the_nearest_point_and_its_neighbours():
    centres = _grid()
    labels = label(
        centres,
        np.zeros(100, int),
        _grasp_at([0.042, 0.051, 0.03]),
        np.array([0]),
        np.random.default_rng(0),
    )
    assert np.flatnonzero(labels.kind == REFERENCE).tolist() == [54]
    assert (labels.kind == CANDIDATE).sum() == 20
    assert (labels.kind == NOT_GRASPABLE).sum() == 79
    reference = np.flatnonzero(labels.voxel == 54)
    assert np.allclose(labels.offset[reference[0]], [0.002, 0.001, -0.02], atol=1e-6)
    assert labels.weight[reference[0]] == 1.0
    assert np.allclose(labels.j_end[0], np.tile([0.0, 0.5, 0.4], 5))
    assert np.allclose(labels.j_init[0], np.tile([0.0, 0.3, 0.08], 5)), "equation (9)"
    assert len(np.unique(labels.voxel[labels.chosen])) == len(labels.chosen) == 21


def test_a_finger_that_closes_into_the_air_hardly_counts() -> None:
    in_air = np.array([[False, False, False, False, True]])
    centres, rng, owner = _grid(), np.random.default_rng(0), np.array([0])
    grasp = _grasp_at([0.042, 0.051, 0.03])
    labels = label(centres, np.zeros(100, int), grasp, owner, rng, in_air=in_air)
    assert (labels.touch == np.repeat([1, 1, 1, 1, np.float32(AIR_SHARE)], 3)).all()
    plain = label(centres, np.zeros(100, int), grasp, owner, rng, paper=True, in_air=in_air)
    assert (plain.touch == 1).all()


def test_labels_leave_out_hidden_objects_and_far_grasps():
    centres = _grid()
    rng, owner = np.random.default_rng(0), np.array([0])
    far = label(centres, np.zeros(100, int), _grasp_at([0.04, 0.05, -0.2]), owner, rng)
    hidden = label(centres, np.full(100, -1), _grasp_at([0.04, 0.05, 0.05]), owner, rng)
    assert (far.kind == NOT_GRASPABLE).all()
    assert not hidden.kind.any() and len(far.voxel) == 0


def test_score_loss_by_hand():
    logits = torch.tensor([[0.0, 0.0], [0.0, np.log(3.0)], [np.log(3.0), 0.0]])
    kind = torch.tensor([0, 1, 2])
    expected = (0.1 * np.log(2) + 1.0 * np.log(4 / 3) + 2.0 * np.log(4)) / 3
    assert score_loss(logits, kind, torch.tensor([0.0, 1.0, 1.0])).item() == pytest.approx(expected, rel=1e-6)
    half = (0.1 * np.log(2) + 0.5 * np.log(4 / 3) + 0.05 * np.log(4) + 2.0 * np.log(4)) / 3
    assert score_loss(logits, kind, torch.tensor([0.0, 0.5, 1.0])).item() == pytest.approx(half, rel=1e-6)


def test_points_are_worth_what_the_grasps_beside_them_are():
    grasps = replace(joined([_grasp_at([0.042, 0.051, 0.03])] * 2), score=np.array([0.9, 0.1]))

    def found(seed: int, **settings: Any) -> Labels:
        rng, owner = np.random.default_rng(seed), np.zeros(2, int)
        return label(_grid(), np.zeros(100, int), grasps, owner, rng, **settings)

    graded, plain = found(0), found(0, paper=True)
    assert graded.worth[54] == pytest.approx(0.9 * (1 - np.exp(-1)), rel=1e-3), "as many grasps as usual"
    assert set(plain.worth.tolist()) == {0.0, 1.0} and not graded.worth[graded.kind == NOT_GRASPABLE].any()
    learnt = [each.grasp[each.voxel == 54] for each in (found(k, grasps_per_point=1) for k in range(40))]
    assert 30 <= sum(0 in each for each in learnt) < 40, "nine times of ten the steadier one"
    worth = np.where(graded.kind[graded.voxel] == REFERENCE, 1.0, CANDIDATE_WEIGHT)
    np.testing.assert_allclose(graded.weight, worth * grasps.score[graded.grasp], rtol=1e-6)
    assert set(plain.weight.tolist()) == {1.0}


def test_a_reference_point_learns_its_own_grasp_before_its_neighbours():
    grasps = joined([_grasp_at([0.042, 0.051, 0.03]), _grasp_at([0.052, 0.051, 0.03])])
    for seed in range(10):
        rng, owner = np.random.default_rng(seed), np.zeros(2, int)
        labels = label(_grid(), np.zeros(100, int), grasps, owner, rng, grasps_per_point=1)
        assert [labels.grasp[labels.voxel == point].tolist() for point in (54, 55)] == [[0], [1]]


def test_of_an_object_of_which_little_is_seen_all_points_are_labelled():
    few = np.where(np.arange(100) // 10 == 5, 0, -1)
    labels = label(_grid(), few, _grasp_at([0.042, 0.051, 0.03]), np.array([0]), np.random.default_rng(0))
    assert np.flatnonzero(labels.kind != NOT_GRASPABLE).tolist() == list(range(50, 60))


def test_rotation_errors_by_hand():
    angle = 0.7
    turn = torch.tensor(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]],
        dtype=torch.float32,
    )
    frobenius, geodesic = rotation_errors(sixd_from_matrix(turn), torch.eye(3))
    assert geodesic.item() == pytest.approx(angle, abs=1e-5)
    assert frobenius.item() == pytest.approx(4 * (1 - np.cos(angle)), abs=1e-5)


def test_rotation_loss_with_one_hypothesis_is_equation_four():
    torch.manual_seed(0)
    predicted, target = torch.randn(5, 1, 6), torch.linalg.qr(torch.randn(5, 3, 3))[0]
    target = target * torch.linalg.det(target).sign()[:, None, None]
    loss, choice, _ = rotation_loss(predicted, torch.zeros(5, 1), target, torch.ones(5))
    frobenius, angle = rotation_errors(predicted[:, 0], target)
    assert loss.item() == pytest.approx((0.5 * frobenius + 0.5 * angle).mean().item(), rel=1e-5)
    assert choice.item() == pytest.approx(0.0)


def test_offset_and_joint_loss_by_hand():
    predicted, target = torch.tensor([[0.02, 0.0, 0.0]]), torch.tensor([[0.01, 0.0, -0.02]])
    assert offset_loss(predicted, target, torch.ones(1)).item() == pytest.approx(0.03 / 0.04)
    joints = joint_loss(
        torch.tensor([[0.1, 0.3], [1.0, 1.0]]),
        torch.tensor([[0.0, 0.0], [0.0, 0.0]]),
        torch.tensor([[1.0, 0.5], [0.0, 0.0]]),
    )
    assert joints.item() == pytest.approx((0.01 + 0.5 * 0.09) / 1.5)


def test_readable_errors_by_hand():
    logits = torch.tensor([[0.0, 1.0], [0.0, 1.0], [0.0, 1.0], [1.0, 0.0]])
    zeros, row = torch.zeros(4, 3), torch.tensor([2])
    batch = SimpleNamespace(
        kind=torch.tensor([1, 0, 0, 2]), voxel=row, chosen=torch.tensor([0]), touch=torch.tensor([[1.0, 1.0, 0.0]]),
        offset=torch.tensor([[0.003, 0.004, 0.0]]), j_end=torch.tensor([[0.1, 0.3, 9.0]]),
    )  # fmt: skip
    two = SimpleNamespace(offset=zeros, j_end=zeros)
    errors = readable_errors(SimpleNamespace(score_logits=logits), two, batch, torch.tensor([0.1, 0.2, 3.0]))  # type: ignore[arg-type]
    values = {name: float(value) for name, value in errors.items()}
    assert values == pytest.approx({
        "precision": 1 / 3, "recall": 1 / 2, "angle_deg": np.rad2deg(0.2), "offset_mm": 5.0, "j_end_rad": 0.2,
    }, rel=1e-5)  # fmt: skip


def test_averaged_weights_do_not_stay_where_the_training_began(dataset: GraspDataset, tmp_path: Path):
    trainer = _trainer(dataset, tmp_path / "run", 1)
    start = torch.nn.utils.parameters_to_vector(trainer.averaged.parameters())
    for batch in trainer.loader():
        trainer.train_step(batch)
    now, averaged = (
        torch.nn.utils.parameters_to_vector(net.parameters()) for net in (trainer.net, trainer.averaged)
    )
    assert 0 < (averaged - now).norm() < 0.3 * (start - now).norm()


def test_augmentation_moves_points_and_grasps_together(
    dataset: GraspDataset, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(batches, "DROP", 0.0)
    view = ViewSource(dataset, 0).view(0, 0)
    grasps = dataset.scene_grasps(dataset.scenes[0])
    moved, carried = augment(view, grasps, np.random.default_rng(1))
    before = np.linalg.norm(view.points[:100, None] - grasps.position[None], axis=-1)
    after = np.linalg.norm(moved.points[:100, None] - carried.position[None], axis=-1)
    assert np.allclose(before, after, atol=1e-5)
    assert not np.allclose(view.points[:100], moved.points[:100], atol=0.01)


def test_cached_view_equals_rendered_view(dataset: GraspDataset, tmp_path: Path):
    rendered, first = ViewSource(dataset, 4).view(1, 3), ViewSource(dataset, 4, cache=tmp_path).view(1, 3)
    cached = ViewSource(dataset, 4, cache=tmp_path).view(1, 3)
    assert np.array_equal(rendered.points, first.points)
    assert np.array_equal(rendered.points, cached.points)
    assert np.array_equal(cached.instance, rendered.instance)


def test_a_cache_of_other_views_is_refused(dataset: GraspDataset, tmp_path: Path) -> None:
    ViewSource(dataset, 4, cache=tmp_path)
    other = replace(dataset, scenes=dataset.scenes[:2])
    for source, keywords in (
        (other, {"seed": 4}),
        (dataset, {"seed": 5}),
        (dataset, {"seed": 4, "keep_table": True}),
    ):
        with refused(ErrorCode.REQUEST_INVALID, "another dataset or with other settings"):
            ViewSource(source, cache=tmp_path, **keywords)


def _trainer(
    dataset: GraspDataset, folder: Path, steps: int, fixed_shapes: int = 0, **wishes: object
) -> Trainer:
    usual = {"batch": 2, "warmup": 2, "workers": 0, "held_out_scenes": 1, "views_per_scene": 2, "threads": 1}
    settings = TrainingSettings(steps=steps, **(usual | wishes))  # type: ignore[arg-type]
    config = replace(PRESETS["tiny"], drop_path=0.3, fixed_shapes=fixed_shapes)
    return Trainer(config, ViewSource(dataset, 0, cache=folder.parent / "views"), folder, settings)


def test_killed_and_resumed_training_equals_an_unbroken_one(dataset: GraspDataset, tmp_path: Path):
    whole = _trainer(dataset, tmp_path / "whole", 6)
    whole.run()
    first = _trainer(dataset, tmp_path / "broken", 6, validate_every=0)
    for batch, _ in zip(first.loader(), range(3), strict=False):
        first.train_step(batch)
    first.save()
    for batch, _ in zip(first.loader(), range(2), strict=False):
        first.train_step(batch)  # lost by the kill
    second = _trainer(dataset, tmp_path / "broken", 6, validate_every=0)
    assert second.resume() and second.step == 3
    second.run()
    for name, value in whole.net.state_dict().items():
        assert torch.equal(value, second.net.state_dict()[name]), name
        assert torch.equal(whole.averaged.state_dict()[name], second.averaged.state_dict()[name]), name


def test_module_two_is_taught_with_the_labels_rotations_or_with_module_ones(
    dataset: GraspDataset, tmp_path: Path
):
    trainer = _trainer(dataset, tmp_path / "run", 1)
    (batch,) = trainer.loader()
    net = trainer.net.eval()
    with torch.no_grad():
        taught, own = (Objective(net, teacher)(batch)[1] for teacher in (True, False))
    assert taught["rotation"] == own["rotation"] and taught["offset"] != own["offset"]


def test_a_training_ends_when_its_time_is_over_and_its_rate_has_fallen_by_then(
    dataset: GraspDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = count(0.0, 0.05)  # a look at it takes so long, and a busy machine takes no more steps away
    monkeypatch.setattr(train, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    wishes = {"minutes": 0.03, "validate_every": 0, "checkpoint_minutes": 0.01}
    trainer, saved = _trainer(dataset, tmp_path / "run", 100_000, **wishes), []
    save = trainer.save
    monkeypatch.setattr(trainer, "save", lambda: saved.append(trainer.step) or save())
    trainer.run()
    assert 0 < saved[0] < saved[1] < saved[-1] == trainer.step and len(saved) < 6
    assert 10 < trainer.step < 36 and 1.8 <= trainer.seconds < 2.0
    assert trainer.optimiser.param_groups[0]["lr"] < 0.5 * trainer.settings.learning_rate
    assert read_curve(trainer.curve)["train"]["step"][-1] == trainer.step
    again = _trainer(dataset, tmp_path / "run", 100_000, minutes=0.03, validate_every=0)
    assert again.resume() and again.over
    longer = _trainer(dataset, tmp_path / "run", 100_000, minutes=0.06, validate_every=0)
    assert longer.resume()
    longer.run()
    assert 1.5 * trainer.step < longer.step < 2.5 * trainer.step, "the time before counts"


def test_the_last_scenes_are_measured_on_as_they_are_and_seen_by_no_step(
    dataset: GraspDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = _trainer(dataset, tmp_path / "run", 4)
    view, seen = trainer.source.view, []
    monkeypatch.setattr(trainer.source, "view", lambda scene, k: seen.append((scene, k)) or view(scene, k))
    assert len(list(trainer.loader())) == 4 and {scene for scene, _ in seen} == {0, 1}
    seen.clear()
    (held_out,) = trainer._held_out
    assert seen == [(2, 0), (2, 1)]
    plain = trainer.collate([ViewDataset(trainer.source, 0, augmented=False)[2, k, 0] for k in range(2)])
    assert torch.equal(held_out.voxels.centres, plain.voxels.centres)


def test_a_gradient_that_is_not_finite_is_left_out_and_many_end_the_training(
    dataset: GraspDataset, tmp_path: Path
) -> None:
    trainer = _trainer(dataset, tmp_path / "run", 40)
    good = next(iter(trainer.loader()))
    bad = replace(good, offset=torch.full_like(good.offset, torch.nan))
    trainer.train_step(good)
    before = {name: value.clone() for name, value in trainer.net.state_dict().items()}
    trainer.train_step(bad)
    assert all(torch.equal(value, before[name]) for name, value in trainer.net.state_dict().items())
    trainer.train_step(good)
    assert trainer.step == 3 and trainer.steps.skipped == 0
    assert any(not torch.equal(value, before[name]) for name, value in trainer.net.state_dict().items())
    with refused(ErrorCode.REQUEST_INVALID, "20 gradients on end are not finite"):
        for _ in range(40):
            trainer.train_step(bad)
    assert trainer.step == 22


def test_a_checkpoint_of_another_training_is_refused(dataset: GraspDataset, tmp_path: Path) -> None:
    first = _trainer(dataset, tmp_path / "run", 6)
    first.step = 3
    first.save()
    assert _trainer(dataset, tmp_path / "run", 9, learning_rate=1e-4, threads=2).resume()
    for wish, words in (({"batch": 4}, "batch 2 instead of 4"), ({"seed": 7}, "seed 0 instead of 7")):
        with refused(ErrorCode.REQUEST_INVALID, words):
            _trainer(dataset, tmp_path / "run", 6, **wish).resume()
    with refused(ErrorCode.REQUEST_INVALID, "fixed_shapes 0 instead of 2"):
        _trainer(dataset, tmp_path / "run", 6, 2).resume()
    other = _trainer(dataset, tmp_path / "run", 6)
    other.notes["dataset"] = {"sha256": "of another file"}
    with refused(ErrorCode.REQUEST_INVALID, "dataset None instead of of another file"):
        other.resume()


def test_a_checkpoint_of_an_older_program_says_nothing_of_its_training(
    dataset: GraspDataset, tmp_path: Path
) -> None:
    first = _trainer(dataset, tmp_path / "run", 6)
    first.save()
    state = torch.load(first.checkpoint, weights_only=True)
    del state["made_from"]
    torch.save(state, first.checkpoint)
    assert _trainer(dataset, tmp_path / "run", 6, batch=4).resume()


def test_curves_hold_training_and_held_out_scenes_and_where_the_time_goes(
    dataset: GraspDataset, tmp_path: Path
):
    trainer = _trainer(dataset, tmp_path / "run", 11, validate_every=10)
    trainer.run()
    curve = read_curve(trainer.curve)
    assert curve["train"]["step"].tolist() == [10, 11] == curve["held_out"]["step"].tolist()
    for split in ("train", "held_out"):
        for name in ("loss", "score", "rotation", "offset", "j_init", "j_end", "angle_deg", "recall"):
            assert np.isfinite(curve[split][name]).all(), (split, name)
    stages = [curve["train"][f"{name}_s"] for name in ("data", "forward", "backward", "optimiser")]
    assert (np.array(stages) > 0).all()
    assert np.isnan(curve["held_out"]["samples_per_s"]).all()
    measured = trainer.validate()
    assert measured == trainer.validate(), "measuring depends on nothing but the weights"
    assert measured["loss"] == pytest.approx(curve["held_out"]["loss"][-1], rel=1e-4)


def test_bf16_on_a_cpu_starts_like_fp32(dataset: GraspDataset, tmp_path: Path):
    first = []
    for precision in ("fp32", "bf16"):
        trainer = _trainer(dataset, tmp_path / precision, 1, precision=precision)
        first.append([float(trainer.train_step(batch)["loss"]) for batch in trainer.loader()][0])
    assert first[1] == pytest.approx(first[0], rel=0.02)


def test_typical_shapes_are_the_means_of_clusters(dataset: GraspDataset, tmp_path: Path):
    joints = np.tile([0.0, 0.5, 0.4, 0.4], 5) + np.array([0.0, 0.02, 0.4, 0.42])[:, None]
    grasps = object_grasps(
        np.zeros((4, 3)), np.eye(3)[None].repeat(4, 0), joints, finger_pattern([5] * 4), np.full(4, GUIDED)
    )
    shapes = typical_shapes(grasps, 2)
    assert shapes.shape == (2, 2, 15)
    wanted = [np.tile([0.0, 0.5, 0.4], 5) + more for more in (0.01, 0.41)]
    assert np.allclose(shapes[np.argsort(shapes[:, 1, 1]), 1], wanted, atol=1e-3)
    begun = _trainer(dataset, tmp_path / "run", 1, fixed_shapes=2).net.two.shapes
    np.testing.assert_array_equal(begun, typical_shapes(dataset.grasps, 2))


def test_rotation_loss_teaches_the_nearest_hypothesis_and_lets_none_die():
    torch.manual_seed(0)
    predicted = torch.randn(5, 3, 6, requires_grad=True)
    loss, *_ = rotation_loss(predicted, torch.zeros(5, 3), torch.eye(3).expand(5, 3, 3), torch.ones(5))
    loss.backward()
    learnt = predicted.grad.norm(dim=2)
    nearest = rotation_errors(predicted.detach(), torch.eye(3))[0].argmin(1)
    assert (learnt > 0).all()
    rest = learnt.scatter(1, nearest[:, None], 0.0)
    assert (learnt.gather(1, nearest[:, None]) > 5 * rest).all()


def test_rotation_loss_teaches_the_hypothesis_that_it_is_told():
    torch.manual_seed(0)
    predicted, target = torch.randn(5, 3, 6), torch.eye(3).expand(5, 3, 3)
    told = torch.tensor([0, 2, 1, 1, 0])
    loss, choice, angle = rotation_loss(predicted, torch.zeros(5, 3), target, torch.ones(5), told)
    only = predicted[torch.arange(5), told][:, None]
    alone, _, _ = rotation_loss(only, torch.zeros(5, 1), target, torch.ones(5))
    assert loss.item() == pytest.approx(alone.item()) and choice.item() == pytest.approx(np.log(3))
    assert torch.allclose(angle, rotation_errors(only[:, 0], target)[1])


@pytest.mark.parametrize("fixed_shapes", [0, 2])
def test_training_lowers_the_loss(dataset: GraspDataset, tmp_path: Path, fixed_shapes: int):
    trainer = _trainer(dataset, tmp_path / "run", 60, fixed_shapes)
    losses = [float(trainer.train_step(batch)["loss"]) for batch in trainer.loader()]
    assert np.mean(losses[-10:]) < 0.85 * np.mean(losses[:5])

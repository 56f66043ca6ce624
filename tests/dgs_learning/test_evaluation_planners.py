"""The baselines on rendered clouds: what they answer, and what they refuse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_learning.dataset import save_dataset
from dgs_learning.evaluation.proposers import PLANNERS, PlannerChoice, planner_factory
from dgs_learning.evaluation.proposers.cloud_shape import cloud_objects, clusters
from dgs_learning.evaluation.proposers.random_prior import prior_of, surface_points
from dgs_learning.evaluation.proposers.top_down import TopDownPlanner
from dgs_learning.evaluation.protocol import Truth
from dgs_learning.objects import shapes
from dgs_learning.training.views import View, ViewSettings, capture
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts
from tests.dgs_learning.tiny_dataset import tiny_dataset

STEEP = replace(ViewSettings(), elevation=(1.0, 1.1))
BLOCK = from_parts("block", "cuboid", "block", shapes.box([0.04, 0.14, 0.07]), 0.2)
CUP = from_parts("cup", "bowl", "cup", shapes.vessel([(0.03, 0.0), (0.033, 0.09)], 0.003), 0.15)


def view_of(*placed: tuple[ObjectModel, float, float, float]) -> View:
    """A view of objects (model, x, y, heading) that stand on the table."""
    poses = []
    for model, x, y, heading in placed:
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        poses.append(transform(turn, (x, y, -float(model.vertices[:, 2].min()))))
    return capture([model for model, *_ in placed], poses, np.random.default_rng(3), STEEP)


def test_clusters_come_apart_where_the_gap_is_wide_enough() -> None:
    rng = np.random.default_rng(0)
    left, right = rng.uniform(0, 0.04, (300, 3)), rng.uniform(0, 0.04, (200, 3)) + [0.06, 0, 0]
    found = clusters(np.concatenate([right, left, [[0.3, 0.3, 0.3]]]))
    assert [len(rows) for rows in found] == [300, 200]


def test_a_cup_is_hollow_and_a_block_is_not() -> None:
    shape_of = {
        name: cloud_objects(view_of((m, 0, 0, 0)).points) for name, m in (("cup", CUP), ("block", BLOCK))
    }
    assert [len(found) for found in shape_of.values()] == [1, 1]
    assert shape_of["cup"][0].filled is not None
    assert shape_of["block"][0].filled is None
    # Inside the block, on its top, above it.
    depth = shape_of["block"][0].sdf(np.array([[0, 0, 0.04], [0, 0, 0.07], [0, 0, 0.09]]))
    assert depth == pytest.approx([-0.02, 0.0, 0.02], abs=0.004)


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0])
def test_top_down_pinches_across_the_narrow_side(heading: float) -> None:
    view = view_of((BLOCK, 0.02, -0.05, heading))
    answer = TopDownPlanner()(view.points, view.camera, np.random.default_rng(0))
    assert len(answer.grasps) > 0
    assert set(answer.stage_times) == {"segment", "close", "checks", "total"}
    best = answer.grasps.select([0])
    narrow = np.array([np.cos(heading), np.sin(heading), 0.0])
    assert abs(best.rotation[0, :, 0] @ narrow) > np.cos(np.deg2rad(30))
    assert best.rotation[0, 2, 2] < -0.8  # from above
    assert np.allclose(best.position, best.reference_point + best.offset)
    assert (np.diff(answer.grasps.score) <= 0).all()


def test_top_down_finds_every_object_and_grips_cups() -> None:
    view = view_of((BLOCK, -0.12, 0.0, 0.3), (CUP, 0.1, 0.05, 0.0))
    grasps = TopDownPlanner()(view.points, view.camera, np.random.default_rng(0)).grasps
    near_cup = np.linalg.norm(grasps.position[:, :2] - [0.1, 0.05], axis=1) < 0.06
    assert near_cup.any()
    assert (~near_cup).any()


@pytest.mark.parametrize("name", ["top_down", "random_prior"])
def test_an_empty_table_is_refused_with_a_code(name: str, tmp_path: Path) -> None:
    save_dataset(tmp_path / "d.npz", tiny_dataset())
    planner = planner_factory(PlannerChoice(name, dataset=tmp_path / "d.npz"))(Truth(lambda: ([], [])))
    table = np.random.default_rng(0).uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.001), (5000, 3)).astype(np.float32)
    with pytest.raises(DgsError) as error:
        planner(table, np.array([0, 0, 1.0]), np.random.default_rng(0))
    assert error.value.code is ErrorCode.NO_OBJECTS


def test_random_prior_keeps_the_offsets_of_the_training_grasps() -> None:
    data = tiny_dataset()
    prior = prior_of(data)
    assert len(prior.offset) == sum(len(scene.instance) for scene in data.scenes)
    stored = data.scene_grasps(data.scenes[0])
    for k, instance in enumerate(data.scenes[0].instance):
        T = data.scenes[0].T_table_object[instance]
        surface = surface_points(data.objects[data.scenes[0].objects[instance]]) @ T[:3, :3].T + T[:3, 3]
        nearest = np.linalg.norm(surface - stored.position[k], axis=1).min()
        assert np.linalg.norm(prior.offset[k]) == pytest.approx(nearest, abs=1e-6)


def test_random_prior_answers_the_same_for_the_same_generator(tmp_path: Path) -> None:
    save_dataset(tmp_path / "d.npz", tiny_dataset())
    view = view_of((BLOCK, 0, 0, 0))
    planner = planner_factory(PlannerChoice("random_prior", dataset=tmp_path / "d.npz"))(
        Truth(lambda: ([], []))
    )
    one, other = (planner(view.points, view.camera, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.grasps.position, other.grasps.position)
    assert sum(one.rejected.values()) > 0


def test_replay_refuses_objects_without_stored_grasps(tmp_path: Path) -> None:
    save_dataset(tmp_path / "d.npz", tiny_dataset())
    truth = Truth(lambda: ([CUP], [transform(position=(0, 0, 0.1))]))
    planner = planner_factory(PlannerChoice("replay", dataset=tmp_path / "d.npz"))(truth)
    with pytest.raises(ValueError, match="no grasps of cup"):
        planner(np.zeros((0, 3), np.float32), np.zeros(3), np.random.default_rng(0))


def test_an_unknown_planner_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(ValueError, match="top_down"):
        PlannerChoice("best")
    assert set(PLANNERS) == {"dgs_net", "top_down", "random_prior", "true_point", "true_rest", "replay"}

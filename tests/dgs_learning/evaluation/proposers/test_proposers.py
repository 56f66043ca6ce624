"""Proposers on rendered clouds: what they answer and refuse, ablated, and with part of the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.frames import Array, transform
from dgs_grasp_planner.network import PRESETS, DGSNet, save_network
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.scene import PlanRequest, Scene, prepare
from dgs_learning.dataset import save_dataset
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.proposers import ablated, planner_of
from dgs_learning.evaluation.proposers.cloud_shape import cloud_objects, clusters
from dgs_learning.evaluation.proposers.random_prior import prior_of, surface_points
from dgs_learning.evaluation.proposers.replay import StoredGrasps
from dgs_learning.evaluation.proposers.top_down import top_down_grasps
from dgs_learning.evaluation.proposers.truth import TruePoint, TrueRest
from dgs_learning.evaluation.protocol import Truth
from dgs_learning.objects import shapes
from dgs_learning.training.views import View, ViewSettings, capture
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts
from tests.dgs_grasp_planner.models import eager_network
from tests.dgs_learning.tiny_dataset import tiny_dataset
from tests.support.refused import refused

STEEP = ViewSettings(elevation=(1.0, 1.1), edges=False)
BLOCK = from_parts("block", "cuboid", "block", shapes.box([0.04, 0.14, 0.07]), 0.2)
CUP = from_parts("cup", "bowl", "cup", shapes.vessel([(0.03, 0.0), (0.033, 0.09)], 0.003), 0.15)
DATA = tiny_dataset()
POSES = list(DATA.scenes[0].T_table_object)


def nothing_known() -> tuple[list[ObjectModel], list[Array]]:
    return [], []


def truth() -> tuple[list[ObjectModel], list[Array]]:
    return DATA.objects, POSES


@pytest.fixture(scope="module")
def known() -> View:
    """What the camera sees of the dataset's first scene."""
    return capture(DATA.objects, POSES, np.random.default_rng(1), replace(STEEP, elevation=(0.9, 1.0)))


@pytest.fixture(scope="module")
def stored() -> StoredGrasps:
    return StoredGrasps(DATA)


@pytest.fixture
def planner_from(tmp_path: Path) -> Callable[[str, Truth], GraspPlanner]:
    """The planner of a proposer, whose stored grasps are the dataset's, in a scene."""
    save_dataset(tmp_path / "d.npz", DATA)
    return lambda name, of: planner_of(Row("a", proposers=(name,), dataset=str(tmp_path / "d.npz")), of)


def scene_of(view: View) -> Scene:
    return prepare(view.points, view.camera, np.random.default_rng(0), PlanRequest())


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
    grasps = top_down_grasps(scene_of(view))
    assert len(grasps) > 0 and (grasps.source == "top_down").all()
    best = grasps[0]
    narrow = np.array([np.cos(heading), np.sin(heading), 0.0])
    assert abs(best.rotation[:, 0] @ narrow) > np.cos(np.deg2rad(30))
    assert best.rotation[2, 2] < -0.8  # from above
    assert (np.diff(grasps.score) <= 0).all()


def test_top_down_finds_every_object_and_grips_cups() -> None:
    view = view_of((BLOCK, -0.12, 0.0, 0.3), (CUP, 0.1, 0.05, 0.0))
    grasps = top_down_grasps(scene_of(view))
    near_cup = np.linalg.norm(grasps.position[:, :2] - [0.1, 0.05], axis=1) < 0.06
    assert near_cup.any()
    assert (~near_cup).any()


@pytest.mark.parametrize("name", ["top_down", "random_prior"])
def test_an_empty_table_is_refused_with_a_code(name: str, planner_from) -> None:
    table = np.random.default_rng(0).uniform((-0.2, -0.2, 0), (0.2, 0.2, 0.001), (5000, 3)).astype(np.float32)
    with refused(ErrorCode.NO_OBJECTS):
        planner_from(name, nothing_known)(table, np.array([0, 0, 1.0]), np.random.default_rng(0))


def test_random_prior_keeps_the_offsets_of_the_training_grasps() -> None:
    prior, scene = prior_of(DATA), DATA.scenes[0]
    assert len(prior.offset) == sum(len(scene.instance) for scene in DATA.scenes)
    stored = DATA.scene_grasps(scene)
    for k, instance in enumerate(scene.instance):
        T = scene.T_table_object[instance]
        surface = surface_points(DATA.objects[scene.objects[instance]]) @ T[:3, :3].T + T[:3, 3]
        nearest = np.linalg.norm(surface - stored.position[k], axis=1).min()
        assert np.linalg.norm(prior.offset[k]) == pytest.approx(nearest, abs=1e-6)


def test_random_prior_answers_the_same_for_the_same_generator(planner_from) -> None:
    view, planner = view_of((BLOCK, 0, 0, 0)), planner_from("random_prior", nothing_known)
    one, other = (planner(view.points, view.camera, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one.grasps.position, other.grasps.position)
    assert sum(one.rejected.values()) > 0


def test_replay_refuses_objects_without_stored_grasps(planner_from) -> None:
    planner = planner_from("replay", lambda: ([CUP], [transform(position=(0, 0, 0.1))]))
    view = view_of((CUP, 0, 0, 0))
    with pytest.raises(ValueError, match="no grasps of cup"):
        planner(view.points, view.camera, np.random.default_rng(0))


@pytest.mark.parametrize("keep_table", [False, True])
def test_a_network_sees_the_table_as_it_was_trained(keep_table: bool, tmp_path: Path) -> None:
    save_network(DGSNet(replace(PRESETS["tiny"], keep_table=keep_table)), tmp_path, "net")
    planner = planner_of(Row("a", proposers=("dgs_net",), weights=str(tmp_path / "net")), nothing_known)
    assert planner.settings.keep_table is keep_table


def test_an_ablation_takes_away_what_the_proposer_says() -> None:
    scene = scene_of(view_of((BLOCK, 0, 0, 0)))
    whole = top_down_grasps(scene)
    assert not ablated(top_down_grasps, "pre_grasp")(scene).pre_grasp_joints.any()
    without_offset = ablated(top_down_grasps, "offset")(scene)
    np.testing.assert_array_equal(without_offset.position, whole.reference_point)
    assert not without_offset.offset.any() and whole.offset.any()


@pytest.mark.timeout(400)
def test_true_points_are_those_next_to_stored_grasps(known: View, stored: StoredGrasps) -> None:
    network, feasible = DgsNet(eager_network()), stored.feasible(truth)
    assert len(feasible) > 0
    grasps = TruePoint(network, stored, truth)(scene_of(known))
    assert len(grasps) > 0
    distance = np.linalg.norm(grasps.reference_point[:, None] - feasible.position[None], axis=2).min(axis=1)
    seen = known.points[known.instance >= 0]
    nearest = np.linalg.norm(feasible.position[:, None] - seen[None], axis=2).min(axis=1)
    assert distance.max() < nearest.max() + 0.012, "a voxel's centre at most from the nearest seen point"
    anywhere = network(scene_of(known))
    far = np.linalg.norm(anywhere.reference_point[:, None] - feasible.position[None], axis=2).min(axis=1)
    assert far.max() > distance.max() + 0.01


@pytest.mark.timeout(400)
def test_the_true_rest_is_a_stored_grasp_near_the_networks_point(known: View, stored: StoredGrasps) -> None:
    grasps = TrueRest(DgsNet(eager_network()), stored, truth)(scene_of(known))
    assert len(grasps) == 1
    feasible = stored.feasible(truth)
    same = np.isclose(feasible.position, grasps.position[0]).all(axis=1)
    assert same.any()
    np.testing.assert_array_equal(grasps.grasp_joints[0], feasible.grasp_joints[same.argmax()])

"""The planner as a callable: determinism, wishes, frames, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from dgs_description.errors import ErrorCode
from dgs_description.frames import transform
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner import scene as scene_module
from dgs_grasp_planner.check import check
from dgs_grasp_planner.contact.shape_completion import shape_completion
from dgs_grasp_planner.load import load_planner, planner_with
from dgs_grasp_planner.network import DGSNet
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_grasp_planner.planner import FALLBACK_SCORE, SHIPPED, STAGES, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.dgs_net import CANDIDATES, DgsNet
from dgs_grasp_planner.rank import LEAST_SCORE
from dgs_grasp_planner.scene import PlanRequest, Region, Scene, prepare
from tests.dgs_grasp_planner.contact.test_closing import grasp
from tests.dgs_grasp_planner.contact.test_fit import BAR
from tests.dgs_grasp_planner.models import eager_network, eager_planner, save_eager_model
from tests.dgs_grasp_planner.network.clouds import batch_of
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene
from tests.support.refused import refused

NETWORK_ALONE = PlannerSettings(without=STAGES, max_grasps=256)


@pytest.fixture(scope="module")
def planner() -> GraspPlanner:
    return eager_planner()


@pytest.fixture(scope="module")
def network_alone() -> GraspPlanner:
    return planner_with(DgsNet(eager_network()), ["dgs_net"], NETWORK_ALONE)


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_same_seed_gives_the_same_answer(planner: GraspPlanner) -> None:
    cloud = table_scene(1, points_per_object=8000)
    first, second, other = (planner(cloud, CAMERA, _rng(seed)) for seed in (4, 4, 5))
    assert first.points_used == 20_000
    assert len(first.grasps) > 0
    for name in ("position", "rotation", "score", "grasp_joints"):
        np.testing.assert_array_equal(getattr(first.grasps, name), getattr(second.grasps, name))
    assert not np.array_equal(first.grasps.position, other.grasps.position)


def test_grasps_pass_the_checks_and_keep_the_contract(planner: GraspPlanner) -> None:
    cloud = table_scene(1)
    prediction = planner(cloud, CAMERA, _rng())
    grasps = prediction.grasps
    assert 0 < len(grasps) <= planner.settings.max_grasps
    assert (np.diff(grasps.score) <= 0).all() and (grasps.score <= 1).all() and (grasps.score > 0).all()
    np.testing.assert_allclose(grasps.position, grasps.reference_point + grasps.offset, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(grasps.rotation), 1.0)
    for joints in (grasps.pre_grasp_joints, grasps.grasp_joints):
        assert (joints >= HAND.lower - 1e-9).all() and (joints <= HAND.upper + 1e-9).all()
    again = check(grasps, cloud[:0]).counts()
    assert set(again) <= {"NOTHING_BETWEEN"}, "nothing goes through the table"
    distance = np.linalg.norm(grasps.reference_point[:, None] - cloud[None], axis=2).min(1)
    assert (distance < 0.006).all(), "reference points are cloud points"
    stages = prediction.stage_times
    of_network, others = ["geometry", "network", "decode"], ["height_field", "level_pinch", "part"]
    assert set(stages) == {"prepare", *of_network, *others, *STAGES, "total"}
    assert sum(stages.values()) - stages["total"] <= stages["total"]


def test_module_two_runs_only_where_needed_and_gives_the_whole_answer(network_alone: GraspPlanner) -> None:
    """The best hypothesis of every reference point equals the full computation of both modules."""
    cloud = table_scene(2, objects=2)
    grasps = network_alone(cloud, CAMERA, _rng()).grasps
    scene = prepare(cloud, CAMERA, _rng(), PlanRequest(), network_alone.settings.keep_table)
    net: DGSNet = network_alone.proposers[0].net
    batch = batch_of([torch.from_numpy(scene.points)], net.config)
    with torch.inference_mode():
        one = net.module_one(batch)
        two = net.module_two(one, one.hypothesis_logits.argmax(1), batch)
    score = one.score_logits.softmax(1)[:, 1].numpy()
    found = 0
    for k in range(len(grasps)):
        row = int(np.linalg.norm(batch.centres.numpy() - grasps.reference_point[k], axis=1).argmin())
        if abs(score[row] - grasps.score[k]) < 1e-6:
            np.testing.assert_allclose(grasps.offset[k], two.offset[row].numpy(), atol=1e-5)
            found += 1
    assert found >= 5


def test_a_lower_score_is_asked_for_where_nothing_is_left() -> None:
    cloud = table_scene(1)
    strict = planner_with(DgsNet(eager_network(), score_threshold=1.0), ["dgs_net"])
    assert len(strict(cloud, CAMERA, _rng()).grasps) > 0
    asked = PlanRequest(min_score=1.0)
    assert len(strict(cloud, CAMERA, _rng(), asked).grasps) == 0, "a wish is no default"


def test_shapes_are_completed_once_for_both_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    original = scene_module.height_field
    monkeypatch.setattr(scene_module, "height_field", lambda *a, **k: made.append(1) or original(*a, **k))
    looks: list[float | None] = []

    def proposes_nothing(scene: Scene) -> GraspSet:
        looks.append(scene.request.min_score)
        assert len(scene.field.shapes)
        return GraspSet.empty()

    GraspPlanner([proposes_nothing])(table_scene(1), CAMERA, _rng())
    assert looks == [None, FALLBACK_SCORE] and len(made) == 1


def test_where_there_are_only_pushes_doubtful_grasps_are_asked_for_too() -> None:
    looks: list[float | None] = []

    def pushes(scene: Scene) -> GraspSet:
        looks.append(scene.request.min_score)
        return replace(grasp(), active_fingers=np.zeros((1, 5), bool))

    GraspPlanner([pushes], PlannerSettings(without=STAGES))(table_scene(1), CAMERA, _rng())
    assert looks == [None, FALLBACK_SCORE]


def test_what_is_not_worth_a_try_is_not_offered() -> None:
    def proposes(scene: Scene) -> GraspSet:
        return joined([grasp(), grasp(x=0.3)])

    alone = PlannerSettings(without=("check",))
    found = GraspPlanner([proposes], alone)(np.vstack([BAR, table_scene(objects=0)]), CAMERA, _rng())
    assert len(found.grasps) == 1 and abs(found.grasps.position[0, 0]) < 0.02
    assert found.grasps.score[0] > LEAST_SCORE and found.rejected == {"UNLIKELY": 1}


def test_likely_grasps_come_before_pushes_and_doubtful_ones_behind_them() -> None:
    push = replace(grasp(), motion=np.array([[0.1, 0.0, 0.0]]), active_fingers=np.zeros((1, 5), bool))
    plain = PlannerSettings(without=("contact", "check", "rank"))

    def proposes(scene: Scene) -> GraspSet:
        return joined([replace(grasp(), score=np.array([score])) for score in (0.3, 0.9, 0.5)] + [push])

    planner = GraspPlanner([proposes], plain)
    found = planner(table_scene(1), CAMERA, _rng()).grasps
    assert found.holds.tolist() == [True, False, True, True]
    assert found.score[found.holds].tolist() == [0.9, 0.5, 0.3]
    few = planner(table_scene(1), CAMERA, _rng(), PlanRequest(max_grasps=2)).grasps
    assert few.holds.tolist() == [True, False]


def test_hands_keep_out_of_boxes_on_their_motion() -> None:
    def proposes(scene: Scene) -> GraspSet:
        return replace(grasp(), motion=np.array([[0.3, 0.0, 0.0]]), active_fingers=np.zeros((1, 5), bool))

    planner = GraspPlanner([proposes], PlannerSettings(without=("contact", "rank")))
    for y, expected in ((0.0, {"IN_KEEP_OUT": 1}), (0.5, {})):
        box = Region(transform(position=(0.3, y, 0.2)), np.full(3, 0.1))
        found = planner(table_scene(objects=1), CAMERA, _rng(), PlanRequest(keep_out=(box,)))
        assert found.rejected == expected


def test_stages_are_left_out_by_name() -> None:
    cloud = table_scene(1)
    whole, unranked, plain = (
        planner_with(DgsNet(eager_network()), ["dgs_net"], PlannerSettings(without=without))(
            cloud, CAMERA, _rng()
        )
        for without in ((), ("rank",), ("contact", "rank"))
    )
    assert {"contact", "rank"} < set(whole.stage_times) and "contact" not in plain.stage_times
    assert "contact" in unranked.stage_times and "rank" not in unranked.stage_times
    assert np.unique(unranked.grasps.grasp_joints, axis=0).shape[0] > 1
    assert 0 < len(whole.grasps) <= len(unranked.grasps) and len(plain.grasps) > 0
    assert not np.isin(plain.grasps.grasp_joints, unranked.grasps.grasp_joints).all(), (
        "contacts change the joints"
    )
    with pytest.raises(ValueError, match="no stage named 'refine'; there are contact, check, rank"):
        PlannerSettings(without=("refine",))


def test_the_proposers_are_chosen_by_name() -> None:
    network = DgsNet(eager_network())
    assert [proposer.name for proposer in planner_with(network).proposers] == list(SHIPPED)
    assert len(planner_with(None, ["level_pinch"]).proposers) == 1
    whole = DgsNet(DGSNet(replace(network.net.config, keep_table=True)))
    assert planner_with(whole).settings.keep_table and not planner_with(network).settings.keep_table
    for proposers in ([], ["dgs_net", "best"]):
        names = "choose from level_pinch, edge_pinch, turn_over, drag, push, part, dgs_net"
        with refused(ErrorCode.PARAMETER_INVALID, names):
            planner_with(network, proposers)


def test_a_planner_without_the_weights_of_hidden_sides_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DGS_MODELS_DIR", str(tmp_path))
    shape_completion.cache_clear()
    with refused(ErrorCode.WEIGHTS_MISSING, "dgs train-shape-completion"):
        planner_with(None, ["level_pinch"])


def test_region_and_limits(network_alone: GraspPlanner) -> None:
    cloud = table_scene(1)
    half = Region(transform(position=(0.0, -0.25, 0.1)), np.array([0.6, 0.5, 0.4]))
    inside = network_alone(cloud, CAMERA, _rng(), PlanRequest(region=half)).grasps
    assert len(inside) > 0 and (inside.reference_point[:, 1] <= 0.001).all()
    nowhere = Region(transform(position=(5.0, 0.0, 0.0)), np.ones(3))
    assert len(network_alone(cloud, CAMERA, _rng(), PlanRequest(region=nowhere)).grasps) == 0
    everything = network_alone(cloud, CAMERA, _rng()).grasps
    two = network_alone(cloud, CAMERA, _rng(), PlanRequest(max_grasps=2)).grasps
    np.testing.assert_array_equal(two.position, everything.position[:2])
    many = network_alone(cloud, CAMERA, _rng(), PlanRequest(max_grasps=256)).grasps
    assert len(many) > len(everything) == CANDIDATES
    limit = float(np.median(everything.score))
    above = network_alone(cloud, CAMERA, _rng(), PlanRequest(min_score=limit)).grasps
    assert 0 < len(above) < len(everything) and (above.score >= limit).all()


def test_the_camera_frame_gives_grasps_in_the_table_frame() -> None:
    net = eager_network()
    camera_net = DGSNet(replace(net.config, frame="camera", features=("ones", "ray", "xyz", "residual")))
    with torch.no_grad():
        camera_net.one.score.out.bias.copy_(torch.tensor([-2.0, 2.0]))
        camera_net.one.score.out.weight.zero_()
        camera_net.one.rotation.out.weight.zero_()
        camera_net.two.out.weight.zero_()
        camera_net.two.out.bias[:3] = torch.tensor([0.0, 0.0, -1.0])
    planner = planner_with(DgsNet(camera_net), ["dgs_net"], NETWORK_ALONE)
    grasps = planner(table_scene(1), CAMERA, _rng()).grasps
    T_table_camera = table_from_input("camera", CAMERA)
    towards_camera = -0.05 * T_table_camera[:3, 2]
    np.testing.assert_allclose(grasps.offset, np.tile(towards_camera, (len(grasps), 1)), atol=1e-6)
    assert (grasps.rotation[:, :, 2] @ T_table_camera[:3, 2] > 0.8).all(), "approach along the view"


def test_loading_from_files(tmp_path: Path) -> None:
    info = save_eager_model(tmp_path)
    planner = load_planner(tmp_path, "tiny")
    network = planner.proposers[0]
    assert isinstance(network, DgsNet) and network.info == info
    assert network.warm_up() > 0
    assert len(planner(table_scene(1), CAMERA, _rng()).grasps) > 0


def test_bf16_finds_grasps_near_those_of_fp32(tmp_path: Path) -> None:
    save_eager_model(tmp_path)
    planners = [load_planner(tmp_path, "tiny", precision=precision) for precision in ("fp32", "bf16")]
    for planner in planners:
        planner.settings = replace(planner.settings, without=("rank",))
    full, half = (planner(table_scene(1), CAMERA, _rng()).grasps for planner in planners)
    assert len(half) > 0
    distance = np.linalg.norm(full.position[:, None] - half.position[None], axis=2).min(1)
    assert np.median(distance) < 0.03

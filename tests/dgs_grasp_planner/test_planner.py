"""The planner as a callable: determinism, wishes, frames, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dgs_grasp_planner.checks import CheckConfig, check_grasps

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_description.grasp import PlanRequest, Region
from dgs_description.joints import HAND_LOWER, HAND_UPPER
from dgs_grasp_planner.contact.fit import RefineConfig
from dgs_grasp_planner.network import DGSNet
from dgs_grasp_planner.network.dgs_net import likeliest_rotation
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_grasp_planner.planner import DgsNetPlanner, PlannerConfig
from tests.dgs_grasp_planner.models import eager_network, save_eager_model
from tests.dgs_grasp_planner.scenes import CAMERA, table_scene

OPEN_CHECKS = CheckConfig(
    table_clearance=-9.0, closed_clearance=-9.0, table_lift=0.0, cloud_points=10**6, between_points=0
)
UNREFINED = RefineConfig(move=False, close=False, rank=False)


@pytest.fixture(scope="module")
def planner() -> DgsNetPlanner:
    return DgsNetPlanner(eager_network())


@pytest.fixture(scope="module")
def unchecked() -> DgsNetPlanner:
    return DgsNetPlanner(eager_network(), PlannerConfig(refine=UNREFINED, checks=OPEN_CHECKS, max_grasps=256))


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_same_seed_gives_the_same_answer(planner: DgsNetPlanner) -> None:
    cloud = table_scene(1, points_per_object=8000)
    first, second, other = (planner(cloud, CAMERA, _rng(seed)) for seed in (4, 4, 5))
    assert first.points_used == 20_000
    assert len(first.grasps) > 0
    for name in ("position", "rotation", "score", "grasp_joints"):
        np.testing.assert_array_equal(getattr(first.grasps, name), getattr(second.grasps, name))
    assert not np.array_equal(first.grasps.position, other.grasps.position)


def test_grasps_pass_the_checks_and_keep_the_contract(planner: DgsNetPlanner) -> None:
    cloud = table_scene(1)
    prediction = planner(cloud, CAMERA, _rng())
    grasps = prediction.grasps
    assert 0 < len(grasps) <= planner.config.max_grasps
    assert (np.diff(grasps.score) <= 0).all() and (grasps.score <= 1).all() and (grasps.score > 0).all()
    np.testing.assert_allclose(grasps.position, grasps.reference_point + grasps.offset, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(grasps.rotation), 1.0)
    for joints in (grasps.pre_grasp_joints, grasps.grasp_joints):
        assert (joints >= HAND_LOWER - 1e-9).all() and (joints <= HAND_UPPER + 1e-9).all()
    again = check_grasps(grasps, cloud[:0], replace(planner.config.checks, between_points=0))
    assert again.accepted.all(), "nothing goes through the table"
    distance = np.linalg.norm(grasps.reference_point[:, None] - cloud[None], axis=2).min(1)
    assert (distance < 0.006).all(), "reference points are cloud points"
    stages = prediction.stage_times
    assert set(stages) == {
        "preprocess",
        "geometry",
        "network",
        "decode",
        "refine",
        "contact",
        "checks",
        "total",
    }
    assert sum(stages.values()) - stages["total"] <= stages["total"]


def test_module_two_runs_only_where_needed_and_gives_the_whole_answer(unchecked: DgsNetPlanner) -> None:
    """The best hypothesis of every reference point equals the full computation of both modules."""
    cloud = table_scene(2, objects=2)
    grasps = unchecked(cloud, CAMERA, _rng()).grasps
    points = torch.from_numpy(cloud)
    from dgs_grasp_planner.network import collate, input_features
    from dgs_grasp_planner.preprocess import prepare_rows

    points = points[prepare_rows(cloud, _rng(), unchecked.config.cloud)]
    net: DGSNet = unchecked.net
    batch = collate(
        [points], [input_features(points, torch.from_numpy(CAMERA).float(), net.config)], net.config
    )
    with torch.inference_mode():
        one = net.module_one(batch)
        two = net.module_two(
            one.features, one.score_logits, likeliest_rotation(one.rotation6d, one.hypothesis_logits), batch
        )
    score = one.score_logits.softmax(1)[:, 1].numpy()
    found = 0
    for k in range(len(grasps)):
        row = int(np.linalg.norm(batch.centres.numpy() - grasps.reference_point[k], axis=1).argmin())
        if abs(score[row] - grasps.score[k]) < 1e-6:
            np.testing.assert_allclose(grasps.offset[k], two.offset[row].numpy(), atol=1e-5)
            found += 1
    assert found >= 5


def test_a_lower_threshold_follows_where_nothing_scores_high_enough(planner: DgsNetPlanner) -> None:
    cloud = table_scene(1)
    decode = replace(planner.config.decode, score_threshold=1.0, fallback_threshold=0.1)
    strict = replace(planner.config, decode=replace(decode, fallback_threshold=1.0))
    with_fallback = DgsNetPlanner(planner.net, replace(planner.config, decode=decode))
    assert len(with_fallback(cloud, CAMERA, _rng()).grasps) > 0
    assert len(DgsNetPlanner(planner.net, strict)(cloud, CAMERA, _rng()).grasps) == 0
    assert len(with_fallback(cloud, CAMERA, _rng(), PlanRequest(min_score=1.0)).grasps) == 0, (
        "a wish is no default"
    )


def test_refinement_closes_the_fingers_onto_the_cloud_and_can_be_switched_off(planner: DgsNetPlanner) -> None:
    cloud = table_scene(1)
    off = DgsNetPlanner(planner.net, replace(planner.config, refine=UNREFINED))
    refined, plain = (p(cloud, CAMERA, _rng()).grasps for p in (planner, off))
    assert len(refined) > 0 and len(plain) > 0
    assert np.unique(refined.grasp_joints, axis=0).shape[0] > 1
    again = off(cloud, CAMERA, _rng()).grasps
    np.testing.assert_array_equal(plain.grasp_joints, again.grasp_joints)
    assert plain.score[0] >= refined.score[0], "the evidence only takes away"


def test_region_and_limits(unchecked: DgsNetPlanner) -> None:
    cloud = table_scene(1)
    half = Region(transform(position=(0.0, -0.25, 0.1)), np.array([0.6, 0.5, 0.4]))
    inside = unchecked(cloud, CAMERA, _rng(), PlanRequest(region=half)).grasps
    assert len(inside) > 0 and (inside.reference_point[:, 1] <= 0.001).all()
    nowhere = Region(transform(position=(5.0, 0.0, 0.0)), np.ones(3))
    assert len(unchecked(cloud, CAMERA, _rng(), PlanRequest(region=nowhere)).grasps) == 0
    everything = unchecked(cloud, CAMERA, _rng()).grasps
    two = unchecked(cloud, CAMERA, _rng(), PlanRequest(max_grasps=2)).grasps
    np.testing.assert_array_equal(two.position, everything.position[:2])
    limit = float(np.median(everything.score))
    above = unchecked(cloud, CAMERA, _rng(), PlanRequest(min_score=limit)).grasps
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
    planner = DgsNetPlanner(camera_net, PlannerConfig(refine=UNREFINED, checks=OPEN_CHECKS))
    grasps = planner(table_scene(1), CAMERA, _rng()).grasps
    T_table_camera = table_from_input("camera", CAMERA)
    towards_camera = -0.05 * T_table_camera[:3, 2]
    np.testing.assert_allclose(grasps.offset, np.tile(towards_camera, (len(grasps), 1)), atol=1e-6)
    assert (grasps.rotation[:, :, 2] @ T_table_camera[:3, 2] > 0.8).all(), "approach along the view"


@pytest.mark.parametrize(
    ("cloud", "code"),
    [
        (np.zeros((0, 3), np.float32), ErrorCode.CLOUD_EMPTY),
        (np.full((9, 3), np.nan, np.float32), ErrorCode.CLOUD_NOT_FINITE),
        (table_scene(objects=0), ErrorCode.NO_OBJECTS),
    ],
)
def test_bad_clouds(planner: DgsNetPlanner, cloud: np.ndarray, code: ErrorCode) -> None:
    with pytest.raises(DgsError) as error:
        planner(cloud, CAMERA, _rng())
    assert error.value.code == code


def test_loading_from_files(tmp_path: Path) -> None:
    info = save_eager_model(tmp_path)
    planner = DgsNetPlanner.from_weights(tmp_path, "tiny")
    assert planner.info == info
    assert planner.warm_up() > 0
    assert len(planner(table_scene(1), CAMERA, _rng()).grasps) > 0


def test_bf16_finds_grasps_near_those_of_fp32(tmp_path: Path) -> None:
    save_eager_model(tmp_path)
    answers = []
    for precision in ("fp32", "bf16"):
        planner = DgsNetPlanner.from_weights(tmp_path, "tiny", precision=precision)
        answers.append(planner(table_scene(1), CAMERA, _rng()).grasps)
    full, half = answers
    assert len(half) > 0
    distance = np.linalg.norm(full.position[:, None] - half.position[None], axis=2).min(1)
    assert np.median(distance) < 0.03

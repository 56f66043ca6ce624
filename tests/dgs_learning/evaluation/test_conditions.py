"""What conditions do to cameras, clouds and the table's height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dgs_description.errors import DgsError
from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.scene import PlanRequest, Prediction
from dgs_learning.evaluation.conditions import MISSING, Condition, holes, no_table, wall
from dgs_learning.training.views import View, ViewSettings, capture
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.world.physics import PHYSICS
from tests.dgs_learning.tiny_dataset import tiny_dataset

DATA = tiny_dataset()
POSES = list(DATA.scenes[0].T_table_object)


@pytest.fixture(scope="module")
def view() -> View:
    return capture(DATA.objects, POSES, np.random.default_rng(1), ViewSettings(elevation=(0.9, 1.0)))


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_holes_are_holes(view: View) -> None:
    left = holes(view.points, view.camera, rng())
    assert 1 - MISSING - 0.15 < len(left) / len(view.points) <= 1 - MISSING
    np.testing.assert_array_equal(left, holes(view.points, view.camera, rng()))


def test_table_and_wall(view: View) -> None:
    assert no_table(view.points, view.camera, rng())[:, 2].min() > 0.005
    more = wall(view.points, view.camera, rng())
    added = more[len(view.points) :]
    away = -view.camera[:2] / np.linalg.norm(view.camera[:2])
    assert len(added) > 1000 and added[:, 2].max() > 0.15
    assert (added[:, :2] @ away).min() > np.percentile(view.points[:, :2] @ away, 90)


def test_noise_is_scaled_and_switched_off() -> None:
    depth = np.full((480, 848), 1.0, dtype=np.float32)
    spread = []
    for factor in (0.0, 1.0, 2.0):
        image = Condition(noise=factor).views((0.4, 0.8)).noise.apply(depth, D455, rng())
        spread.append(float(image[image > 0].std()))
    assert spread[0] < 1e-3 < spread[1] < spread[2]
    plain, worn, none = (Condition(**c).views((0.4, 0.8)).noise for c in ({}, {"worn": True}, {"noise": 0}))
    assert plain == D455Noise() and worn.subpixel_rms == 2 * plain.subpixel_rms
    assert none.quantisation == 0.0 < worn.quantisation


def test_without_a_condition_the_views_are_those_of_the_training() -> None:
    assert Condition().described() == {}
    assert Condition(noise=2.0).described() == {"condition": {"noise": 2.0}}
    assert Condition().views((0.35, 0.35)) == ViewSettings(crop=(0.35, 0.35, 0.30))


def test_a_wrong_table_height_shifts_what_the_planner_sees_and_not_its_grasps(view: View) -> None:
    """A planner that grasps at the highest point it sees must end at the true one."""
    heard: list[float] = []

    def highest(
        cloud: np.ndarray, camera: ArrayLike, generator: np.random.Generator, request: PlanRequest
    ) -> Prediction:
        top = cloud[cloud[:, 2].argmax()].astype(float)
        heard.extend([float(top[2]), float(np.asarray(camera)[2]), float(request.failed[0, 2, 3])])
        one = GraspSet.of(
            "test", position=top, rotation=np.eye(3), pre_grasp_joints=np.zeros(20), grasp_joints=np.zeros(20),
            active_fingers=np.ones(5), score=1.0, reference_point=top,
        )  # fmt: skip
        return Prediction(one, len(cloud), {})

    planner = Condition(table_error=0.005).disturb(highest, [0])
    failed = transform(position=(0.1, 0.0, 0.3))[None]
    answer = planner(view.points, view.camera, rng(), PlanRequest(failed=failed))
    true = float(view.points[:, 2].max())
    assert heard == pytest.approx([true + 0.005, view.camera[2] + 0.005, 0.305], abs=1e-6)
    assert answer.grasps.position[0, 2] == pytest.approx(true, abs=1e-6)
    assert answer.grasps.reference_point[0, 2] == pytest.approx(true, abs=1e-6)


def test_half_of_the_objects_are_glass_the_same_ones_each_time_and_lie_as_before() -> None:
    scene = replace(DATA.scenes[0], objects=np.arange(len(DATA.objects)))
    made = []
    for _ in range(2):
        with Condition(transparent=0.5).world(DATA.objects, scene, "pybullet", [0, 104, 0]) as world:
            made.append([model.material for model in world.models])
            poses = list(world.object_poses().values())
    assert made[0] == made[1]
    assert made[0].count("glass") == round(0.5 * len(scene.objects))
    with Condition().world(DATA.objects, scene, "pybullet", [0, 104, 0]) as world:
        assert {model.material for model in world.models} == {"opaque"}
        np.testing.assert_array_equal(poses, list(world.object_poses().values()))


def test_worn_hardware_is_as_worn_as_is_said_and_the_same_each_time() -> None:
    scene = replace(DATA.scenes[0], objects=np.arange(len(DATA.objects)))
    worn, friction, mass, zeros = Condition(worn=True), [], [], []
    for number in (*range(8), 0):
        with worn.world(DATA.objects, scene, "pybullet", [0, 104, number]) as world:
            friction.append([PHYSICS.hand_friction * model.friction for model in world.models])
            mass.append(
                [model.mass / new.mass for model, new in zip(world.models, DATA.objects, strict=True)]
            )
            zeros.append(world.world.joints()[0] - world.world.posture())
            np.testing.assert_allclose(HAND.expand(HAND.reduce(zeros[-1])), zeros[-1], atol=1e-9)
    for drawn, low, high in ((friction, 0.4, 0.9), (mass, 0.7, 1.5), (zeros, -0.03, 0.03)):
        assert (
            low
            <= np.min(drawn)
            < low + 0.2 * (high - low)
            < high - 0.2 * (high - low)
            < np.max(drawn)
            <= high
        )
        np.testing.assert_array_equal(drawn[0], drawn[-1])


def test_after_a_hand_eye_error_the_planner_sees_another_table_and_the_hand_goes_where_it_says() -> None:
    corners = np.concatenate([np.zeros((1, 3)), 0.1 * np.eye(3)]).astype(np.float32)
    seen: list[np.ndarray] = []

    def planner(
        cloud: np.ndarray, camera: ArrayLike, generator: np.random.Generator, request: PlanRequest
    ) -> Prediction:
        seen.append(cloud)
        still = np.zeros((4, 20))
        grasps = GraspSet.of(
            "test", position=cloud, rotation=np.tile(np.eye(3), (4, 1, 1)), pre_grasp_joints=still,
            grasp_joints=still, active_fingers=True,
        )  # fmt: skip
        return Prediction(grasps, len(cloud), {})

    shifts, turns = [], []
    for number in range(20):
        disturbed = Condition(worn=True).disturb(planner, [0, 104, number])
        answer = disturbed(corners, np.array([0.0, 0.0, 1.0]), rng(), PlanRequest())
        np.testing.assert_array_equal(answer.grasps.position, seen[-1])
        axes = (seen[-1][1:] - seen[-1][0]) / 0.1
        shifts.append(float(np.linalg.norm(seen[-1][0])))
        turns.append(np.rad2deg(np.arccos((np.trace(axes) - 1) / 2)))
    assert 0.003 < max(shifts) < 0.0051 and 0.6 < max(turns) < 1.05


def test_depth_comes_from_where_the_condition_says() -> None:
    glass = [replace(model, material="glass") for model in DATA.objects]
    seen = {}
    for source in ("raw", "stereo"):
        views = replace(Condition(depth_from=source).views((0.4, 0.4)), elevation=(0.9, 1.0))
        seen[source] = capture(glass, POSES, np.random.default_rng(1), views)
    opaque = capture(DATA.objects, POSES, np.random.default_rng(1), ViewSettings(elevation=(0.9, 1.0)))
    assert (seen["raw"].camera == opaque.camera).all() and (seen["stereo"].camera == opaque.camera).all()
    higher = {name: (view.points[:, 2] > 0.01).sum() for name, view in seen.items()}
    assert higher["raw"] < 0.6 * (opaque.points[:, 2] > 0.01).sum()
    assert len(seen["stereo"].points) > 0.8 * len(opaque.points)


def test_conditions_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="share"):
        Condition(transparent=1.5)
    with pytest.raises(ValueError, match="table_error"):
        Condition(worn=True, table_error=0.01)
    with pytest.raises(ValueError, match="friction"):
        Condition(worn=True, friction=0.4)
    with pytest.raises(DgsError, match="depth source"):
        Condition(depth_from="magic")

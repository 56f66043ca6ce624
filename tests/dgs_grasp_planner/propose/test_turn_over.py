"""Turning over: only domes that stick out, fingers beneath the rim, past the table's edge and over it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.planner import LAST, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.edge_pinch import EdgePinch
from dgs_grasp_planner.propose.push import Push, PushSettings
from dgs_grasp_planner.propose.turn_over import AHEAD, UP, TurnOver, turns_over
from dgs_grasp_planner.scene import PlanRequest, Region, Scene
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, on_table

EDGE = -0.25
RADIUS = 0.07
AT_THE_EDGE = EDGE + 0.018


def bowl(
    x: float = AT_THE_EDGE, y: float = 0.0, upside_down: bool = True, radius: float = RADIUS
) -> np.ndarray:
    """What is seen of a bowl around (x, y)."""
    dx, dy = np.stack(np.meshgrid(*2 * [np.arange(-radius, radius, 0.0015)]), -1).reshape(-1, 2).T
    away = np.hypot(dx, dy)
    dome = radius * np.sqrt(np.maximum(1 - (away / (radius + 0.002)) ** 2, 0.0))
    height = np.where(upside_down, dome, np.maximum(radius + 0.005 - dome, 0.004))
    return np.column_stack([dx + x, dy + y, height])[away < radius]


def scene_of(points: np.ndarray, edge: float | None = EDGE) -> Scene:
    return Scene(points.astype(np.float32), CAMERA, np.random.default_rng(0), edge=edge)


def test_fingers_go_beneath_the_rim_then_up_and_over_the_table() -> None:
    grasps = turns_over(field_of(bowl()), EDGE)
    assert len(grasps) >= 6 and (grasps.source == "turn_over").all() and not grasps.holds.any()
    straight = np.abs(grasps.motion[:, 1]) < 1e-9
    assert grasps.score[straight].min() > grasps.score[~straight].max()
    for grasp in grasps:
        spheres = HAND.finger_spheres(grasp.grasp_joints)[1:] @ grasp.rotation.T + grasp.position
        inside = spheres[..., 0] > AT_THE_EDGE - RADIUS
        assert inside.any() and (spheres[..., 2] + HAND.sphere_radii)[inside].max() < 0.0, "beneath the rim"
        assert (spheres[..., 0] + HAND.sphere_radii).max() < EDGE, "before the table"
        for share in np.linspace(0.0, 1.0, 100):
            there = spheres + share * grasp.motion
            outside = np.maximum(np.stack([EDGE - there[..., 0], there[..., 2]], axis=-1), 0.0)
            assert (np.linalg.norm(outside, axis=-1) > HAND.sphere_radii - 0.004).all(), (
                "past the table's edge"
            )
        assert np.linalg.norm(grasp.motion[:2]) == pytest.approx(AHEAD / UP * grasp.motion[2])
        assert 2 * RADIUS < grasp.motion[2] < 2.8 * RADIUS, "higher than it is wide"


@pytest.mark.parametrize(
    ("points", "edge"),
    [
        (bowl(), None),
        (bowl(upside_down=False), EDGE),
        (bowl(EDGE + 0.1), EDGE),
        (bowl(radius=0.04), EDGE),
        (np.concatenate([bowl(), bowl(AT_THE_EDGE + 0.16, radius=0.04)]), EDGE),
    ],
    ids=[
        "no edge",
        "upright",
        "it does not stick out",
        "the hand is wide enough",
        "no room where it would lie",
    ],
)
def test_nothing_else_is_turned_over(points: np.ndarray, edge: float | None) -> None:
    assert not len(TurnOver()(scene_of(points, edge)))


def test_domes_are_pushed_to_the_edge_where_they_can_be_turned_over_and_not_pinched_there() -> None:
    assert not len(EdgePinch()(scene_of(bowl()))) and len(EdgePinch()(scene_of(bowl(upside_down=False))))
    lying = scene_of(bowl(AT_THE_EDGE + 0.2))
    assert abs(Push()(lying).best_first().rotation[0, 0, 2]) < 1e-6, "by an upright hand"
    aside = Push(PushSettings(turning=(0.1, 0.2)))(lying)
    towards = aside.motion[:, 0] < -0.05
    assert len(aside) and not (towards & (np.abs(aside.motion[:, 1]) < 0.05)).any(), (
        "not straight to the edge"
    )


def test_of_an_upright_bowl_everything_comes_before_it_is_pushed_to_the_edge() -> None:
    upright, dome = (scene_of(bowl(AT_THE_EDGE + 0.2, upside_down=down)) for down in (False, True))
    assert [shape.vessel for scene in (upright, dome) for shape in scene.field.shapes.values()] == [
        True,
        False,
    ]
    last = Push()(upright)
    assert len(last) and (last.score < LAST).all() and Push()(dome).score.max() > 0.5
    hopeless = replace(last[:1], score=np.array([0.31]), active_fingers=np.ones((1, 5), bool))
    settings = PlannerSettings(edge=EDGE, without=("contact", "check", "rank"))
    planner = GraspPlanner([Push(), lambda scene: hopeless], settings)
    cloud = on_table(bowl(AT_THE_EDGE + 0.2, upside_down=False))
    holds = planner(cloud, CAMERA, np.random.default_rng(0)).grasps.holds
    assert holds[0] and len(holds) > 1 and not holds[1:].any()
    pinched = EdgePinch()(scene_of(bowl(upside_down=False))).score.max()
    assert 0.0 < pinched <= 0.5, "and its pinch there after grasps of its rim"


def test_the_stages_leave_them_as_they_are_and_the_check_knows_the_edge() -> None:
    cloud = bowl()
    grasps = turns_over(field_of(cloud), EDGE)
    fitted = fit(grasps, field_of(cloud))
    np.testing.assert_array_equal(fitted.position, grasps.position)
    assert check(fitted, cloud[::7], edge=EDGE).accepted.any()
    assert not check(fitted, cloud[::7]).accepted.any(), "a table everywhere is in the way"


@pytest.mark.parametrize("upside_down", [True, False])
def test_what_is_hollow_is_moved_for_who_asks_for_its_rim(upside_down: bool) -> None:
    x = AT_THE_EDGE if upside_down else AT_THE_EDGE + 0.2
    planner = GraspPlanner([TurnOver(), Push()], PlannerSettings(edge=EDGE))
    top = np.array([[x, 0.0, RADIUS - 0.005]] if upside_down else [[x + RADIUS - 0.002, 0.0, RADIUS]])
    around = Region(transform(position=(x, 0.0, 0.105)), np.array([0.3, 0.3, 0.2]))  # begins above the table
    elsewhere = Region(transform(position=(x + 0.5, 0.0, 0.105)), np.array([0.3, 0.3, 0.2]))
    wishes = (
        PlanRequest(),
        PlanRequest(targets=top),
        PlanRequest(region=around),
        PlanRequest(region=elsewhere),
    )
    cloud = on_table(bowl(x, upside_down=upside_down))
    counts = [len(planner(cloud, CAMERA, np.random.default_rng(0), wish).grasps) for wish in wishes]
    assert counts[0] == counts[1] == counts[2] > 0 == counts[3]
    # What the noise of its floor leaves in its middle is no voxel of its own.
    speck = np.random.default_rng(1).uniform((x - 2e-3, -2e-3, 0.011), (x + 2e-3, 2e-3, 0.013), (20, 3))
    specked = np.concatenate([cloud, speck.astype(cloud.dtype)])
    found = [len(planner(specked, CAMERA, np.random.default_rng(0), wish).grasps) for wish in wishes[:2]]
    assert found[0] == found[1] > 0

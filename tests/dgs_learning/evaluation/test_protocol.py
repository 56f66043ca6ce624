"""Scenes of a setting, and when a scene ends."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.scene import Prediction
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.protocol import MAX_PUSHES, NO_GRASP, Setting, draw_scene, run_scene
from dgs_sim_bridge.render.object_model import find_catalogue


def test_a_planner_that_finds_nothing_ends_the_scene_after_two_views() -> None:
    seen = []

    def factory(truth):
        models, _ = truth()
        seen.append(len(models))
        return lambda cloud, camera, rng, request: Prediction(GraspSet.empty(), len(cloud), {})

    clouds = []
    result = run_scene(
        find_catalogue("novel"),
        factory,
        Setting(objects_per_scene=(2, 2), area=(0.4, 0.4), seed=4),
        0,
        Condition(),
        "pybullet",
        keep=lambda run, view: clouds.append((len(run.attempts) - 1, len(view.points))),
    )
    assert (result.cleared, len(result.attempts)) == (0, 2)
    assert result.objects == seen[0]
    assert [k for k, _ in clouds] == [0, 1]


def in_the_air(source: str, **values: object) -> GraspSet:
    """A grasp far from everything."""
    return GraspSet.of(
        source,
        position=(0.0, 0.0, 0.8),
        rotation=np.diag([1.0, -1.0, -1.0]),
        pre_grasp_joints=np.zeros(20),
        grasp_joints=np.zeros(20),
        **values,
    )


def test_the_planner_is_told_what_failed() -> None:
    told = []

    def planner(cloud, camera, rng, request):
        told.append(request.failed)
        return Prediction(in_the_air("dgs_net", active_fingers=True), len(cloud), {})

    setting = Setting(objects_per_scene=(1, 1), area=(0.4, 0.4), seed=4)
    run_scene(find_catalogue("novel"), lambda truth: planner, setting, 0, Condition(), "pybullet")
    assert [len(poses) for poses in told] == [0, 1, 2]
    np.testing.assert_allclose(told[2][:, :3, 3], [(0.0, 0.0, 0.8)] * 2)


def test_a_thing_that_is_pushed_again_and_again_is_taken_away() -> None:
    """Pushes are no attempts at a grasp; the hand, far from everything, moves nothing here."""
    nowhere = in_the_air("push", active_fingers=False, motion=(-0.01, 0.0, 0.0))
    setting = Setting(objects_per_scene=(1, 1), area=(0.4, 0.4), seed=4, edge=-0.25)
    assert setting.seen == pytest.approx((0.4, 0.3))
    result = run_scene(
        find_catalogue("novel"),
        lambda truth: lambda cloud, camera, rng, request: Prediction(nowhere, len(cloud), {}),
        setting,
        0,
        Condition(),
        "pybullet",
    )
    assert len(result.attempts) == MAX_PUSHES + 1 and result.cleared == 0
    assert all(a.pushed and not a.executed and a.item == 0 for a in result.attempts)
    summary = summarise([result])
    assert (summary["pushes"], summary["attempts"]) == (MAX_PUSHES + 1, 0)
    assert summary["losses"][0]["ends"] == {NO_GRASP: 1} and sum(summary["failures"].values()) == 0


def test_the_published_scenes_stay_what_they_are() -> None:
    """Summaries name seed and catalogue only: scene 0 of seed 0, 4 to 6 novel objects, as it was measured on."""
    catalogue = find_catalogue("novel")
    scene = draw_scene(catalogue, Setting(objects_per_scene=(4, 6), area=(0.4, 0.8), seed=0), 0)
    names = ["oval_bowl_004", "flask_009", "hex_box_006", "ramekin_006"]
    assert [catalogue[k].name for k in scene.objects] == names
    places = [
        (-0.0096, -0.3013, 0.0338), (0.0113, 0.2672, 0.0338), (-0.1378, -0.2973, 0.0407), (-0.1039, 0.3584, 0.0289),
    ]  # fmt: skip
    assert scene.T_table_object[:, :3, 3] == pytest.approx(np.array(places), abs=2e-4)


@pytest.mark.parametrize(
    "wrong",
    [{"scenes": 0}, {"objects_per_scene": (5, 4)}, {"area": (0.1, 0.4)}],
)
def test_impossible_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError):
        Setting(**wrong)

"""Scenes of a setting, and when a scene ends."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.scene import Prediction
from dgs_learning.evaluation.protocol import Setting, draw_scene, run_scene
from dgs_sim_bridge.render.object_model import find_catalogue


def test_a_planner_that_finds_nothing_ends_the_scene_after_two_views() -> None:
    seen = []

    def factory(truth):
        models, _ = truth.scene()
        seen.append(len(models))
        return lambda cloud, camera, rng, request: Prediction(GraspSet.empty(), len(cloud), {})

    clouds = []
    result = run_scene(
        find_catalogue("novel"),
        factory,
        Setting(objects_per_scene=(2, 2), area=(0.4, 0.4), seed=4),
        0,
        keep=lambda run, view: clouds.append((len(run.attempts) - 1, len(view.points))),
    )
    assert (result.cleared, len(result.attempts)) == (0, 2)
    assert result.objects == seen[0]
    assert [k for k, _ in clouds] == [0, 1]


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

"""Scenes of a setting, and when a scene ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.scene import Prediction
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.protocol import MAX_PUSHES, NO_GRASP, Setting, draw_scene, plan, run_scene
from dgs_learning.evaluation.scene_world import Attempt, Moment, Outcome, SceneWorld
from dgs_learning.training.views import View
from dgs_sim_bridge.render.object_model import find_catalogue
from tests.dgs_learning.evaluation.proposers.test_proposers import BLOCK
from tests.support.refused import refused


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


IN_PALM = transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, -0.13))
"""Of a hand that points down, 0.13 m below what is then in the middle of its palm."""


class Scripted(SceneWorld):
    """Four blocks in a row; attempts end as is told, and where the thing slipped, with the palm inside of it."""

    def __init__(self, ends: list[tuple[Outcome, int]]) -> None:
        self.models = [replace(BLOCK, name=f"block_{k}") for k in range(4)]
        self.poses = {k: transform(position=(0.1 * k - 0.1, 0.0, 0.036)) for k in range(4)}
        self.ends, self.settled = iter(ends), 0

    @property
    def left(self) -> list[int]:
        return list(self.poses)

    def __exit__(self, *_: object) -> None: ...

    def object_poses(self) -> dict[int, Array]:
        return dict(self.poses)

    def remove(self, index: int) -> None:
        del self.poses[index]

    def settle(self) -> None:
        self.settled += 1

    def execute(self, grasp: GraspSet) -> Attempt:
        outcome, index = next(self.ends)
        T_table_tcp = self.poses[index] @ IN_PALM if outcome is Outcome.SLIPPED else grasp.pose
        moment = Moment(grasp.grasp_joints, T_table_tcp, self.object_poses())
        if outcome is Outcome.PUSHED:  # off the table
            self.poses[index] = transform(position=(0.1 * index - 0.1, 0.45, 0.036))
        return Attempt(outcome, index, moment, None)


def test_what_is_lifted_failed_on_three_times_or_lost_is_gone_and_only_the_first_counts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ends = [(Outcome.SLIPPED, 1), (Outcome.SUCCESS, 1), (Outcome.PUSHED, 3), *[(Outcome.MISSED, 0)] * 3]
    world, told = Scripted([*ends, (Outcome.SUCCESS, 2)]), []

    def planner(cloud, camera, rng, request):
        outcome = ends[len(told)][0] if len(told) < len(ends) else Outcome.SUCCESS
        told.append((len(request.failed), world.left, world.settled))
        push = {"active_fingers": False, "motion": (0.0, 0.3, 0.0)}
        grasp = (
            in_the_air("push", **push) if outcome is Outcome.PUSHED else in_the_air("a", active_fingers=True)
        )
        inside = replace(grasp, position=(IN_PALM[:3, 3] + (0.0, 0.0, 0.036))[None])
        return Prediction(inside if outcome in (Outcome.SUCCESS, Outcome.PUSHED) else grasp, len(cloud), {})

    monkeypatch.setattr(Condition, "world", lambda *_: world)
    setting = Setting(objects_per_scene=(4, 4), area=(0.4, 0.4))
    result = run_scene(find_catalogue("novel"), lambda truth: planner, setting, 0, Condition(), "pybullet")
    assert (result.objects, result.cleared, world.left) == (4, 2, [])
    assert [item.cleared for item in result.items] == [False, True, True, False]
    every, rest, last = [0, 1, 2, 3], [0, 2, 3], [0, 2]
    assert [left for _, left, _ in told] == [every, every, rest, last, last, last, [2]]
    assert [failed for failed, _, _ in told] == [0, 1, 0, 0, 1, 2, 3], (
        "what held takes along what failed there"
    )
    assert [settled for *_, settled in told] == list(range(1, 8)), "before every look"
    deep = [(a.pd_mm > 1.0, a.pv_mm3 > 100.0) for a in result.attempts]
    closed = [(a.pd_closed_mm > 1.0, a.pv_closed_mm3 > 100.0) for a in result.attempts]
    yes, no = (True, True), (False, False)
    assert closed[0] == yes != deep[0] and (deep[2], closed[2]) == (no, no), "of a push none is measured"
    assert deep[1] == yes and deep[3:6] == closed[3:6] == [no] * 3


@pytest.mark.parametrize("code", [ErrorCode.NO_OBJECTS, ErrorCode.NO_GRASP, ErrorCode.WEIGHTS_MISSING])
def test_a_planner_that_sees_nothing_answers_nothing_and_one_that_is_broken_ends_the_run(
    code: ErrorCode,
) -> None:
    def planner(*_: object) -> Prediction:
        raise DgsError(code, "why")

    view = View(np.zeros((5, 3), np.float32), np.zeros(5, np.int16), np.ones(3))
    if code is ErrorCode.WEIGHTS_MISSING:
        with refused(code):
            plan(planner, view, np.random.default_rng(0))
        return
    answer = plan(planner, view, np.random.default_rng(0))
    assert (len(answer.grasps), answer.points_used, answer.rejected) == (0, 5, {code.name: 1})


def test_a_scene_has_no_more_objects_than_the_catalogue() -> None:
    setting = Setting(objects_per_scene=(3, 3), area=(0.4, 0.4))
    assert sorted(draw_scene(find_catalogue("novel")[:2], setting, 0).objects) == [0, 1]


def test_a_thing_that_is_pushed_again_and_again_is_taken_away() -> None:
    """Pushes are no attempts at a grasp; the hand, far from everything, moves nothing here."""
    nowhere = in_the_air("push", active_fingers=False, motion=(-0.01, 0.0, 0.0))
    setting = Setting(objects_per_scene=(1, 1), area=(0.4, 0.4), seed=4, edge=-0.25)
    assert setting.seen == pytest.approx((0.4, 0.3))
    seen = []

    def planner(cloud, camera, rng, request):
        seen.append(cloud[:, 0].min())
        return Prediction(nowhere, len(cloud), {})

    result = run_scene(find_catalogue("novel"), lambda truth: planner, setting, 0, Condition(), "pybullet")
    assert len(result.attempts) == MAX_PUSHES + 1 and result.cleared == 0
    assert all(a.pushed and not a.executed and a.item == 0 for a in result.attempts)
    summary = summarise([result])
    assert (summary["pushes"], summary["attempts"]) == (MAX_PUSHES + 1, 0)
    assert summary["losses"][0]["ends"] == {NO_GRASP: 1} and sum(summary["failures"].values()) == 0
    assert not any(part["attempts"] for part in summary["per_kind"].values())
    assert min(seen) > -0.27, "beyond its edge there is no table"


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
    [{"scenes": 0}, {"objects_per_scene": (5, 4)}, {"area": (0.1, 0.4)}, {"area": (0.4, 1.1)}],
)
def test_impossible_settings_are_refused(wrong: dict) -> None:
    with pytest.raises(ValueError):
        Setting(**wrong)

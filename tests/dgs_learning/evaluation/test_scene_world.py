"""The judge itself: the same hand around a block, beside it, in its way; and when an attempt failed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.pick import LIFT
from dgs_grasp_planner.planner import GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.drag import Drag
from dgs_grasp_planner.propose.edge_pinch import EdgePinch
from dgs_grasp_planner.propose.push import Push
from dgs_grasp_planner.propose.turn_over import TurnOver
from dgs_learning.evaluation.proposers.top_down import top_down_grasps
from dgs_learning.evaluation.scene_world import MOVED, SLIP, Attempt, Outcome, SceneWorld
from dgs_learning.objects.catalogue import make_catalogue
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.training.views import ViewSettings, capture
from dgs_sim_bridge.render.object_model import ObjectModel, find_catalogue
from dgs_sim_bridge.world.engines import ENGINES
from dgs_sim_bridge.world.hand_world import Wear
from tests.dgs_learning.evaluation.proposers.test_proposers import BLOCK, scene_of

POSE = transform(position=(0, 0, 0.036))
EDGE = -0.25
"""Of the table, where there is one [m]."""


@pytest.fixture(scope="module")
def best() -> GraspSet:
    view = capture([BLOCK], [POSE], np.random.default_rng(0), ViewSettings())
    return top_down_grasps(scene_of(view))[0]


def world_of(model: ObjectModel, engine: str = "pybullet") -> SceneWorld:
    return SceneWorld([model], Scene(np.array([0]), POSE[None]), engine)


def alone_at_edge(model: ObjectModel, pose: Array, engine: str) -> SceneWorld:
    return SceneWorld([model], Scene(np.array([0]), pose[None]), engine, edge=EDGE)


def one_try(world: SceneWorld, planner: GraspPlanner, rng: np.random.Generator) -> tuple[GraspSet, Attempt]:
    """The planner's first grasp of what is seen now, and what comes of it."""
    view = capture(*world.scene(), rng, ViewSettings(elevation=(0.8, 1.2)), EDGE)
    grasp = planner(view.points, view.camera, rng).grasps[0]
    return grasp, world.execute(grasp)


def rise(attempt: Attempt) -> float:
    """Of the hand, from closing to the moment of failure [m]."""
    assert attempt.failed is not None
    return float(attempt.failed.T_table_tcp[2, 3] - attempt.closed.T_table_tcp[2, 3])


def test_a_block_is_lifted_by_a_good_grasp_and_missed_by_a_far_one(best: GraspSet) -> None:
    with world_of(BLOCK) as world:
        missed = world.execute(replace(best, position=best.position + [0.15, 0, 0]))
        good = world.execute(best)
    assert missed.outcome is Outcome.MISSED
    assert missed.failed is missed.closed
    assert good.outcome is Outcome.SUCCESS
    assert good.object_index == 0 and good.failed is None
    assert np.allclose(good.closed.T_table_tcp, best.pose, atol=2e-3)
    assert good.closed.objects[0][2, 3] == pytest.approx(0.036, abs=0.02)


def test_lifted_is_higher_by_a_tenth_of_a_metre_and_shaken_along_both_level_axes() -> None:
    with world_of(BLOCK) as world:
        before, way = world.object_poses(), []
        for rise, lifted in ((0.095, []), (0.105, [0])):
            world.world.place(0, transform(position=(0, 0, rise)) @ POSE)
            assert world._lifted(before) == lifted
        carry = world.world.carry
        world.world.carry = lambda T: way.append(T[:3, 3]) or carry(T)
        world._shake_and_hold(transform(position=(0, 0, 0.5)), before)
    assert np.ptp(way, axis=0) == pytest.approx((0.04, 0.04, 0.0)) and way[0][2] == pytest.approx(0.5 + LIFT)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_case_is_pushed_over_the_edge_and_pinched_there(engine: str) -> None:
    case = next(m for m in find_catalogue("household") if m.name == "game_case_000")
    planner = GraspPlanner([EdgePinch(), Push()], PlannerSettings(edge=EDGE))
    rng, outcomes = np.random.default_rng(0), []
    with alone_at_edge(case, transform(position=(0.0, 0.0, 0.008)), engine) as world:
        for _ in range(4):
            world.settle()
            _, attempt = one_try(world, planner, rng)
            outcomes.append(attempt.outcome)
            assert attempt.object_index == 0
            if attempt.outcome is not Outcome.PUSHED:
                break
            assert attempt.failed is None and attempt.closed.objects[0][0, 3] < -0.1
    assert outcomes[-1] is Outcome.SUCCESS and outcomes[:-1] == [Outcome.PUSHED] * (len(outcomes) - 1)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_spanner_is_dragged_until_its_end_sticks_out_and_pinched_there(engine: str) -> None:
    spanner = next(m for m in make_catalogue("everyday") if m.family == "spanner")
    planner = GraspPlanner([EdgePinch(), Drag()], PlannerSettings(edge=EDGE))
    rng, outcomes = np.random.default_rng(0), []
    with alone_at_edge(spanner, transform(position=(0.0, 0.0, 0.006)), engine) as world:
        for _ in range(4):
            world.settle()
            before = world.object_poses()[0]
            grasp, attempt = one_try(world, planner, rng)
            outcomes.append(attempt.outcome)
            if attempt.outcome is not Outcome.PUSHED:
                break
            moved = attempt.closed.objects[0][:3, 3] - before[:3, 3]
            assert moved[0] < -0.3 * abs(grasp.motion[0]) and abs(moved[2]) < 0.01, "along the table"
            np.testing.assert_allclose(
                world.object_poses()[0][:3, 3], attempt.closed.objects[0][:3, 3], atol=0.015
            )
    assert outcomes[-1] is Outcome.SUCCESS and outcomes[:-1] == [Outcome.PUSHED] * (len(outcomes) - 1) != []


@pytest.mark.parametrize("engine", ENGINES)
def test_a_bowl_on_its_rim_is_pushed_over_the_edge_and_turned_over(engine: str) -> None:
    bowl = next(m for m in find_catalogue("train") if m.name == "bowl_021@1.20")
    pose = transform(np.diag([1.0, -1.0, -1.0]), (-0.1, 0.0, float(bowl.vertices[:, 2].max())))
    planner, rng = GraspPlanner([TurnOver(), Push()], PlannerSettings(edge=EDGE)), np.random.default_rng(0)
    with alone_at_edge(bowl, pose, engine) as world:
        for _ in range(4):
            world.settle()
            if world.object_poses()[0][2, 2] > 0.0:
                break
            assert one_try(world, planner, rng)[1].outcome is Outcome.PUSHED
        world.settle()
        T_table_bowl = world.object_poses()[0]
    assert T_table_bowl[2, 2] > 0.0 and T_table_bowl[0, 3] > EDGE + 0.05, (
        "upright or on its side, on the table"
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_what_was_pushed_stays_where_the_hand_leaves_it(engine: str) -> None:
    """The ring finger has yielded by 0.4 rad: this bowl was flung off the table by a hand that rose at once."""
    bowl = next(m for m in find_catalogue("novel") if m.name == "ramekin_003")
    pose = transform(Rotation.from_euler("z", 118.8, degrees=True).as_matrix(), (-0.0796, -0.1031, 0.017))
    lean = 0.0905
    axes = np.array(
        [[1.0, 0.0, 0.0], [0.0, -np.cos(lean), np.sin(lean)], [0.0, -np.sin(lean), -np.cos(lean)]]
    )
    shape = HAND.split(np.zeros(HAND.joint_count))
    shape[:, 1] = 0.0, 0.05, 0.5, 0.05, 0.9
    joints = shape.reshape(HAND.joint_count)
    push = GraspSet.of(
        "push",
        position=(0.0573, -0.1092, 0.0575),
        rotation=axes,
        pre_grasp_joints=joints,
        grasp_joints=joints,
        active_fingers=False,
        score=0.9,
        reference_point=(-0.08, -0.103, 0.04),
        motion=(-0.278, 0.0, 0.0),
    )[0]
    with SceneWorld([bowl], Scene(np.array([0]), pose[None]), engine, edge=-0.35) as world:
        world.settle()
        pushed = world.execute(push)
        world.settle()
        before, after = pushed.closed.objects[0], world.object_poses()[0]
    assert pushed.outcome is Outcome.PUSHED and before[0, 3] < -0.28
    np.testing.assert_allclose(after[:3, 3], before[:3, 3], atol=0.005)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_push_that_moves_nothing_is_that_of_the_thing_it_was_meant_for(engine: str, best: GraspSet) -> None:
    poses = np.array([transform(position=(x, 0.0, 0.036)) for x in (-0.15, 0.15)])
    pushes = [
        replace(
            best,
            position=best.position + [0.0, 0.0, 0.3],
            active_fingers=np.zeros(5, bool),
            motion=np.array([-0.01, 0.0, 0.0]),
            reference_point=pose[:3, 3] + [0.02, 0.0, 0.03],
        )
        for pose in poses
    ]
    with SceneWorld([BLOCK, BLOCK], Scene(np.arange(2), poses), engine) as world:
        attempts = [world.execute(push) for push in pushes]
    assert [attempt.object_index for attempt in attempts] == [0, 1]


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_kept_of_a_worn_hand_is_how_it_is_not_what_it_measures(engine: str, best: GraspSet) -> None:
    zeros = np.tile([0.0, -0.03, 0.02, 0.02], 5)
    air = replace(
        best,
        position=best.position + [0.0, 0.0, 0.3],
        active_fingers=np.zeros(5, bool),
        motion=0.01 * np.eye(3)[0],
    )
    with SceneWorld([BLOCK], Scene(np.array([0]), POSE[None]), engine, wear=Wear(zeros=zeros)) as world:
        closed = world.execute(air).closed
    assert closed.joints == pytest.approx(best.pre_grasp_joints - zeros, abs=0.005)


def test_what_falls_off_the_table_is_lost() -> None:
    off = transform(position=(-0.2, 0.0, 0.036))
    with SceneWorld([BLOCK], Scene(np.array([0]), off[None]), edge=-0.1) as world:
        world.settle()
        world.drop_lost((1.0, 1.0))
        assert not world.left


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_too_heavy_fails_when_the_hand_leaves_it_behind(engine: str, best: GraspSet) -> None:
    with world_of(replace(BLOCK, mass=3.0), engine) as world:
        attempt = world.execute(best)
    assert attempt.outcome is Outcome.SLIPPED and attempt.failed is not None
    assert attempt.failed.moved == 0
    assert rise(attempt) == pytest.approx(SLIP, abs=0.005)
    assert attempt.failed.objects[0][2, 3] == pytest.approx(0.036, abs=0.005), "it stays on the table"


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_in_the_way_fails_before_the_hand_closes(engine: str, best: GraspSet) -> None:
    with world_of(BLOCK, engine) as world:
        attempt = world.execute(replace(best, position=best.position + [0.03, 0, 0]))
    assert attempt.outcome is Outcome.APPROACH_CONTACT and attempt.failed is not None
    shift = np.linalg.norm(attempt.failed.objects[0][:3, 3] - POSE[:3, 3])
    assert shift == pytest.approx(MOVED, abs=0.002)
    assert rise(attempt) > 0.01, "still on its way down"


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_lost_after_the_lift_fails_up_there(engine: str, best: GraspSet) -> None:
    with world_of(BLOCK, engine) as world:
        hold = world._shake_and_hold

        def oil(*args: object) -> list[int]:
            world.world.set_friction(0.0)
            return hold(*args)

        world._shake_and_hold = oil
        attempt = world.execute(best)
    assert attempt.outcome is Outcome.LOST_IN_LIFT and attempt.failed is not None
    assert attempt.failed.moved == 0
    assert rise(attempt) == pytest.approx(LIFT, abs=0.01)
    fallen = attempt.closed.objects[0][2, 3] + LIFT - attempt.failed.objects[0][2, 3]
    assert 0.0 < fallen < 0.04, "it has only just begun to fall"

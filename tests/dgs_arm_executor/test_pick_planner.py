from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dgs_arm_executor import pick_planner
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_checkers import PickCheckers, check_grasp
from dgs_arm_executor.pick_plan import PickPlan, PickSettings
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.planning_scene import BESIDE, CARRIED, CLOUD, PlanningScene, SceneSettings
from dgs_arm_executor.safety import Envelope, check_trajectory
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from tests.support.grasps import top_grasp, top_grasps
from tests.support.picks import NOTHING, PLACE, at_home, cylinder, verify
from tests.support.refused import refused


def test_whole_picks_in_random_scenes(planner: PickPlanner) -> None:
    rng, planned = np.random.default_rng(5), 0
    for _ in range(4):
        places = rng.uniform((0.18, -0.3), (0.4, 0.3), (3, 2))
        cloud = ObstacleCloud.from_points(np.concatenate([cylinder(*place) for place in places]))
        grasps = [
            top_grasps((*places[k % 3], -0.09), rng.uniform(-0.5, 0.5), rng.uniform(0, 6.28))
            for k in range(8)
        ]
        answer = planner.plan(at_home(cloud), joined(grasps))
        skipped = [rejection.index for rejection in answer.rejections]
        if answer.plan is None:
            assert skipped == list(range(8))
            continue
        planned += 1
        assert skipped == list(range(answer.plan.index))
        assert list(answer.plan.trajectories) == ["transfer", "approach", "lift", "carry", "home"]
        verify(planner, answer.plan, HOME_ARM, cloud)
        np.testing.assert_allclose(answer.plan.trajectories["home"].end, HOME_ARM, atol=1e-9)
        release = planner.ik.tcp(answer.plan.trajectories["carry"].end)
        box = answer.plan.load.box
        assert box is not None
        np.testing.assert_allclose((release @ box.T_tcp_box)[:2, 3], CELL.bin_centre, atol=1e-8)
        assert release[2, 3] > CELL.table_height + CELL.bin_size[2] + 0.05
    assert planned >= 3


@pytest.mark.parametrize("seed", range(6))
def test_the_hand_keeps_clear_of_what_touches_the_target_while_it_carries(
    planner: PickPlanner, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x, y, yaw = rng.uniform(0.2, 0.42), rng.uniform(-0.28, 0.28), rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(yaw), np.sin(yaw)])
    bottle = cylinder(*((x, y) + 0.115 * along), height=0.27, radius=0.035)
    low = rng.uniform((-0.08, -0.02), (0.08, 0.02), (6000, 2)) @ [along, (-along[1], along[0])]
    bar = np.column_stack([low + (x, y), np.full(len(low), CELL.table_height + 0.05)])
    cloud = ObstacleCloud.from_points(np.concatenate([bar, bottle]))
    grasps = joined(
        [
            top_grasps((*((x, y) - 0.02 * along), CELL.table_height + 0.07), yaw=yaw + turn)
            for turn in (np.pi / 2, -np.pi / 2)
        ]
    )
    plan = planner.plan(at_home(cloud), grasps).plan
    if plan is None:
        pytest.skip("out of reach")
    alone = PlanningScene(ObstacleCloud.from_points(bottle), SceneSettings(arm_clearance=0.0))
    for stage, hand in (("carry", plan.grasp.grasp_joints), ("home", HAND.open_hand)):
        free = alone.checker(hand)
        met = [pair for q in plan.trajectories[stage].positions for pair in free.contacts(q) if CLOUD in pair]
        assert not met, (stage, met[:3])


def test_a_bin_that_is_out_of_reach_is_no_path(planner: PickPlanner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_arm_executor.pick_planner.release_states", lambda *_: np.zeros((0, 6)))
    answer = planner.plan(at_home(), top_grasps(PLACE))
    assert answer.plan is None and [each.code for each in answer.rejections] == [ErrorCode.NO_PATH]


def test_no_stage_leaves_the_box_that_the_safety_envelope_wants(planner: PickPlanner) -> None:
    upper = (0.45, 0.70, 1.00)
    boxed = PickPlanner(scene_settings=SceneSettings(tcp_upper=upper))
    situation = at_home(ObstacleCloud.from_points(cylinder(0.25, 0.1)))
    far_out, farther = top_grasps((0.25, 0.1, -0.09)), top_grasps((0.50, 0.0, -0.09))

    def blocked(plan: PickPlan) -> list[str]:
        out, here = [], HOME_ARM
        for stage, way in plan.trajectories.items():
            hand = plan.grasp.grasp_joints if stage in ("lift", "carry") else plan.grasp.pre_grasp_joints
            try:
                check_trajectory(
                    way.times, way.positions, way.velocities, here, hand, Envelope(tcp_upper=upper)
                )
            except DgsError as error:
                assert error.code == ErrorCode.SAFETY_ENVELOPE
                out.append(stage)
            here = way.end
        return out

    swings = planner.plan(situation, far_out).chosen()
    assert "transfer" in blocked(swings), "the shortest way swings out of the box"
    assert blocked(boxed.plan(situation, far_out).chosen()) == []
    assert planner.plan(situation, farther).plan is not None
    (rejection,) = boxed.plan(situation, farther).rejections
    assert rejection.code == ErrorCode.COLLISION_APPROACH and "leaves its box" in rejection.reason


def test_every_refused_candidate_has_its_reason(planner: PickPlanner) -> None:
    wall = np.random.default_rng(0).uniform((0.26, 0.03, -0.2), (0.34, 0.05, 0.1), (9000, 3))
    cloud = ObstacleCloud.from_points(np.concatenate([wall, cylinder(0.25, -0.25)]))
    good = top_grasps((0.3, 0.0, -0.1))
    grasps = [
        top_grasps((0.9, 0.0, -0.1)),
        top_grasps((0.25, -0.25, -0.23)),
        top_grasps(PLACE),
        top_grasps((0.3, 0.0, -0.1), tilt=np.pi),
        top_grasps((0.3, 0.0, float("nan"))),
        replace(good, grasp_joints=np.full((1, 20), 3.0)),
        replace(good, rotation=np.diag([1.0, 1.0, 2.0])[None]),
        replace(good, active_fingers=np.zeros((1, 5), bool)),
        top_grasps((0.25, -0.25, -0.09)),
    ]
    answer = planner.plan(at_home(cloud), joined(grasps))
    codes = {rejection.index: rejection.code for rejection in answer.rejections}
    assert answer.chosen().index == 8
    assert codes[0] == ErrorCode.OUT_OF_REACH
    assert codes[1] == ErrorCode.COLLISION_APPROACH
    assert codes[2] in (ErrorCode.COLLISION_STAND_OFF, ErrorCode.COLLISION_APPROACH)
    assert codes[4] == codes[5] == codes[6] == codes[7] == ErrorCode.GRASP_INVALID
    assert all(len(rejection.reason) > 10 for rejection in answer.rejections)


def test_one_that_is_as_good_and_had_without_a_detour_is_taken(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.2, 0.0))
    around, straight = top_grasps((0.2, 0.0, -0.14), 0.35, 4.0), top_grasps((0.25, -0.25, -0.09))
    alone = planner.plan(at_home(cloud), around).chosen()
    for score, index in ((0.86, 1), (0.8, 0), (0.96, 0)):
        grasps = replace(joined([around, straight]), score=np.array([0.9, score]))
        answer = planner.plan(at_home(cloud), grasps)
        assert answer.chosen().index == index
        assert len(answer.rejections) == index
        if index:
            assert "needs a detour" in answer.rejections[0].reason
            assert answer.chosen().duration < alone.duration


def test_what_only_the_lift_meets_is_a_collision_on_the_lift(planner: PickPlanner) -> None:
    grasps = top_grasps((0.25, -0.25, -0.09), tilt=0.3)
    blocks = [np.zeros((0, 3))]
    # Put something where the lifted hand would be but the one on its way to the grasp is not, branch after branch.
    for _ in range(8):
        answer = planner.plan(at_home(ObstacleCloud.from_points(np.concatenate(blocks))), grasps)
        if answer.plan is None:
            break
        lifted = planner.ik.tcp(answer.plan.trajectories["lift"].end)
        points = np.random.default_rng(0).uniform(lifted[:3, 3] - 0.15, lifted[:3, 3] + 0.15, (60000, 3))
        for q in np.concatenate(
            [answer.plan.trajectories[k].positions[-60::8] for k in ("transfer", "approach")]
        ):
            points = without_robot(points, q, grasps[0].pre_grasp_joints)
        gripping = answer.plan.trajectories["approach"].end
        points = without_robot(points, gripping, grasps[0].grasp_joints)
        blocks.append(points)
    assert answer.plan is None
    assert answer.rejections[0].code == ErrorCode.COLLISION_LIFT, answer.rejections
    assert "on the lift" in answer.rejections[0].reason and "observed cloud" in answer.rejections[0].reason


def test_keep_holding_ends_after_the_lift(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps(PLACE), keep_holding=True).chosen()
    assert list(plan.trajectories) == ["transfer", "approach", "lift"]


def test_lift_from_where_closing_pushed_the_arm_ends_where_the_plan_goes_on(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps((0.3, 0.1, -0.13))).chosen()
    pushed = plan.trajectories["approach"].end + np.array([0.01, -0.08, 0.05, 0.02, -0.03, 0.04])
    lift = planner.plan_off(pushed, plan, "lift")
    np.testing.assert_allclose(lift.positions[0], pushed, atol=1e-9)
    np.testing.assert_allclose(lift.positions[-1], plan.trajectories["carry"].positions[0], atol=1e-6)
    assert np.abs(lift.velocities[[0, -1]]).max() < 1e-6, "at rest at both ends"


def test_the_nearest_branch_is_taken(planner: PickPlanner) -> None:
    first = planner.plan(at_home(), top_grasps(PLACE)).chosen()
    stand_off = first.trajectories["approach"].positions[0]
    again = planner.plan(ArmSituation(stand_off, HAND.open_hand), top_grasps(PLACE)).chosen()
    np.testing.assert_allclose(again.trajectories["approach"].positions[0], stand_off, atol=1e-6)
    assert np.abs(np.diff(again.trajectories["transfer"].positions, axis=0)).max() < 1e-6


def test_no_candidates(planner: PickPlanner) -> None:
    with refused(ErrorCode.NO_CANDIDATES):
        planner.plan(at_home(), GraspSet.empty())


def test_time_limit_ends_the_search(planner: PickPlanner) -> None:
    hasty = PickPlanner(planner.ik, PickSettings(planning_time=0.0))
    answer = hasty.plan(at_home(), top_grasps(np.tile(PLACE, (3, 1))))
    assert answer.plan is None and {r.code for r in answer.rejections} == {ErrorCode.NO_PATH}
    assert all("not looked at" in r.reason for r in answer.rejections)


def test_a_time_limit_is_not_told_as_if_a_grasp_had_not_been_looked_at(
    planner: PickPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    around = at_home(ObstacleCloud.from_points(cylinder(0.2, 0.0)))
    moments = iter([0.0, 1.0, planner.settings.planning_time + 1.0])
    monkeypatch.setattr(pick_planner, "time", SimpleNamespace(perf_counter=moments.__next__))
    (rejection,) = planner.plan(around, top_grasps((0.2, 0.0, -0.14), 0.35, 4.0)).rejections
    assert "no detour was looked for" in rejection.reason


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, "is not a rotation"),
        ({"drags": np.True_, "motion": np.array([0.1, 0.0, 0.0])}, "drags, but"),
        ({}, "name no finger"),
    ],
)
def test_what_is_no_grasp_is_refused(wrong: dict[str, np.ndarray], said: str) -> None:
    with refused(ErrorCode.GRASP_INVALID, said):
        check_grasp(replace(top_grasp(*PLACE), active_fingers=np.zeros(5, dtype=bool), **wrong))


def test_hand_joints_just_beyond_their_limits_are_clipped() -> None:
    slightly = replace(top_grasp(*PLACE), pre_grasp_joints=np.tile([-0.27, -0.01, -0.01, -0.01], 5))
    clipped = check_grasp(slightly)
    assert (HAND.split(clipped.pre_grasp_joints)[:, 1:] == 0.0).all()


def test_the_hand_takes_its_shape_on_the_way_only_where_no_shape_in_between_is_in_the_way(
    planner: PickPlanner,
) -> None:
    grasp = replace(top_grasp(0.3, 0.0, -0.165), pre_grasp_joints=np.tile([0.0, 1.2, 1.0, 1.0], 5))
    straight, bent = (
        PickCheckers(PlanningScene(), grasp, hand) for hand in (HAND.open_hand, grasp.pre_grasp_joints)
    )
    (q, *_) = (q for q in planner.ik.states(grasp.pose, HOME_ARM) if not bent.transfer.in_collision(q))
    assert straight.shaping[0].in_collision(q), "straight fingers reach into the table"
    assert not any(checker.in_collision(q) for checker in bent.shaping)
    assert bent.home.in_collision(q), "with an open hand"
    push = replace(grasp, active_fingers=np.zeros(5, dtype=bool), motion=np.array([0.1, 0.0, 0.0]))
    assert not PickCheckers(PlanningScene(), push).home.in_collision(q), "in the shape that has pushed"


def test_the_rest_of_a_large_thing_is_not_in_the_way_of_its_gripped_end(planner: PickPlanner) -> None:
    tray = np.random.default_rng(0).uniform((0.2, -0.1, 0.02), (0.4, 0.18, 0.03), (60_000, 3))
    cloud = ObstacleCloud.from_points(tray + (0.0, 0.0, CELL.table_height))
    grasp = top_grasp(0.3, 0.1, -0.15)
    assert not cloud.target_mask(grasp).all()
    q = planner.ik.states(transform(position=(0.0, 0.0, 0.01)) @ grasp.pose, HOME_ARM)[0]
    assert (CARRIED, BESIDE) not in PickCheckers(PlanningScene(cloud), grasp).carry.contacts(q)


def test_a_hand_opens_no_wider_than_arm_and_cell_allow(planner: PickPlanner) -> None:
    grasp = top_grasp(*PLACE)
    np.testing.assert_array_equal(planner.opened(at_home(), grasp.pre_grasp_joints), HAND.open_hand)
    folded = HOME_ARM.copy()
    for folded[4] in np.linspace(-np.pi, np.pi, 200):
        opened = planner.opened(ArmSituation(folded, HAND.open_hand, cloud=NOTHING), grasp.pre_grasp_joints)
        if not np.array_equal(opened, HAND.open_hand):
            break
    np.testing.assert_array_equal(opened, grasp.pre_grasp_joints)
    assert PlanningScene(NOTHING).checker(HAND.open_hand).in_collision(folded)

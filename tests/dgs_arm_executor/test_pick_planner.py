from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.pick_checkers import PickCheckers, check_grasp
from dgs_arm_executor.pick_plan import PickPlan, PickSettings
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.planning_scene import PlanningScene, SceneSettings
from dgs_arm_executor.release import release_states
from dgs_arm_executor.safety import Envelope, check_trajectory
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import CELL, HOME_ARM, apply
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.propose.edge_pinch import edge_pinches
from dgs_grasp_planner.propose.push import pushes
from tests.support.grasps import FINAL, top_grasp, top_grasps
from tests.support.refused import refused

PLACE = np.array([0.3, 0.1, -0.09])


NOTHING = ObstacleCloud()


def at_home(cloud: ObstacleCloud = NOTHING) -> ArmSituation:
    return ArmSituation(HOME_ARM, HAND.open_hand, cloud=cloud)


def cylinder(x: float, y: float, height: float = 0.09, radius: float = 0.025) -> np.ndarray:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 3000)
    z = CELL.table_height + rng.uniform(0, height, 3000)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z], axis=1)


def verify(planner: PickPlanner, plan: PickPlan, start: np.ndarray, cloud: ObstacleCloud) -> None:
    """The stages join, each passes the safety check, and each is free at every sample, by fresh checkers."""
    scene, chosen = PlanningScene(cloud), plan.grasp
    released = cloud.target_mask(chosen)
    hands = {
        "transfer": chosen.pre_grasp_joints,
        "approach": chosen.pre_grasp_joints,
        "advance": chosen.pre_grasp_joints,
        "lift": chosen.grasp_joints,
        "carry": chosen.grasp_joints,
        "home": HAND.open_hand if chosen.holds else chosen.grasp_joints,
    }
    checkers = {stage: scene.checker(hand, released=released) for stage, hand in hands.items()} | {
        "transfer": scene.checker(chosen.pre_grasp_joints, cloud_clearance=0.005),
        "lift": scene.checker(chosen.grasp_joints, released=released, hand_on_table=True),
    }
    here = start
    for stage, trajectory in plan.trajectories.items():
        np.testing.assert_allclose(trajectory.positions[0], here, atol=1e-9)
        check_trajectory(trajectory.times, trajectory.positions, trajectory.velocities, here, hands[stage])
        assert checkers[stage].first_collision(trajectory.positions) is None, stage
        here = trajectory.end
    np.testing.assert_allclose(planner.ik.tcp(plan.trajectories["approach"].end), chosen.pose, atol=1e-8)
    lifted = planner.ik.tcp(plan.trajectories["lift"].end)
    up = lifted[:3, 3] - chosen.closing_pose[:3, 3]
    np.testing.assert_allclose(up, (0, 0, planner.settings.lift), atol=1e-8)


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
        np.testing.assert_allclose(
            apply(release, (box.lower + box.upper) / 2)[:2], CELL.bin_centre, atol=1e-8
        )
        assert release[2, 3] > CELL.table_height + CELL.bin_size[2] + 0.05
    assert planned >= 3


def slab(x: float, y: float, height: float = 0.015) -> np.ndarray:
    """The top of a flat thing of 0.12 x 0.18 m."""
    rng = np.random.default_rng(0)
    low, high = (x - 0.06, y - 0.09, height), (x + 0.06, y + 0.09, height)
    return rng.uniform(low, high, (20_000, 3)) + (0, 0, CELL.table_height)


EDGE = CELL.table_edge - CELL.workspace_centre[0]


def in_frame_table(points: np.ndarray) -> np.ndarray:
    return points - CELL.T_base_table[:3, 3]


@pytest.mark.parametrize("y", [0.2, 0.3])
def test_what_sticks_out_over_the_edge_is_pinched_from_outside(planner: PickPlanner, y: float) -> None:
    points = slab(CELL.table_edge, y)
    pinches = edge_pinches(height_field(in_frame_table(points)), EDGE).moved(CELL.T_base_table)
    cloud = ObstacleCloud.from_points(points)
    plan = planner.plan(at_home(cloud), pinches).plan
    assert plan is not None
    assert list(plan.trajectories) == ["transfer", "approach", "advance", "lift", "carry", "home"]
    verify(planner, plan, HOME_ARM, cloud)
    lowest = planner.ik.tcp(plan.trajectories["advance"].end)[2, 3]
    assert lowest < CELL.table_height + 0.05


@pytest.mark.parametrize("y", [-0.3, -0.2, 0.3])
def test_a_push_moves_on_goes_up_and_home_with_nothing(planner: PickPlanner, y: float) -> None:
    points = slab(0.3, y)
    found = pushes(height_field(in_frame_table(points)), EDGE).moved(CELL.T_base_table)
    cloud = ObstacleCloud.from_points(points)
    plan = planner.plan(at_home(cloud), found).plan
    assert plan is not None
    assert list(plan.trajectories) == ["transfer", "approach", "advance", "lift", "home"]
    verify(planner, plan, HOME_ARM, cloud)
    way = planner.ik.tcp(plan.trajectories["advance"].end) - planner.ik.tcp(plan.trajectories["approach"].end)
    np.testing.assert_allclose(way[:3, 3], plan.grasp.motion, atol=1e-8)


def test_picks_from_any_free_start(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1))
    checker = PlanningScene(cloud).checker(HAND.open_hand)
    rng = np.random.default_rng(8)
    draws = HOME_ARM + rng.uniform(-1.0, 1.0, (60, 6)) * (2.5, 0.6, 0.6, 1.0, 1.0, 3.0)
    starts = [q for q in draws if not checker.in_collision(q)][:3]
    assert len(starts) == 3
    for start in starts:
        answer = planner.plan(ArmSituation(start, HAND.open_hand, cloud=cloud), top_grasps(PLACE))
        assert answer.plan is not None, answer.rejections
        verify(planner, answer.plan, start, cloud)


def test_no_stage_leaves_the_box_that_the_safety_envelope_wants(planner: PickPlanner) -> None:
    upper = (0.45, 0.70, 1.00)
    boxed = PickPlanner(scene_settings=SceneSettings(workspace_upper=upper))
    situation = at_home(ObstacleCloud.from_points(cylinder(0.25, 0.1)))
    far_out, farther = top_grasps((0.25, 0.1, -0.09)), top_grasps((0.50, 0.0, -0.09))

    def blocked(plan: PickPlan) -> list[str]:
        out, here = [], HOME_ARM
        for stage, way in plan.trajectories.items():
            hand = plan.grasp.grasp_joints if stage in ("lift", "carry") else plan.grasp.pre_grasp_joints
            try:
                check_trajectory(
                    way.times, way.positions, way.velocities, here, hand, Envelope(workspace_upper=upper)
                )
            except DgsError as error:
                assert error.code == ErrorCode.SAFETY_ENVELOPE
                out.append(stage)
            here = way.end
        return out

    plans = [p.plan(situation, far_out).plan for p in (planner, boxed)]
    assert plans[0] is not None and plans[1] is not None
    assert "transfer" in blocked(plans[0]), "the shortest way swings out of the box"
    assert blocked(plans[1]) == []
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
    assert answer.plan is not None and answer.plan.index == 8
    assert codes[0] == ErrorCode.OUT_OF_REACH
    assert codes[1] == ErrorCode.COLLISION_APPROACH
    assert codes[2] in (ErrorCode.COLLISION_STAND_OFF, ErrorCode.COLLISION_APPROACH)
    assert codes[4] == codes[5] == codes[6] == codes[7] == ErrorCode.GRASP_INVALID
    assert all(len(rejection.reason) > 10 for rejection in answer.rejections)


def test_one_that_is_as_good_and_had_without_a_detour_is_taken(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.2, 0.0))
    around, straight = top_grasps((0.2, 0.0, -0.14), 0.35, 4.0), top_grasps((0.25, -0.25, -0.09))
    alone = planner.plan(at_home(cloud), around).chosen()
    for score, index in ((0.86, 1), (0.8, 0)):
        grasps = replace(joined([around, straight]), score=np.array([0.9, score]))
        answer = planner.plan(at_home(cloud), grasps)
        assert answer.chosen().index == index
        assert len(answer.rejections) == index
        if index:
            assert "needs a detour" in answer.rejections[0].reason
            assert answer.chosen().duration < 0.7 * alone.duration


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
    answer = planner.plan(at_home(), top_grasps(PLACE), keep_holding=True)
    assert answer.plan is not None and list(answer.plan.trajectories) == ["transfer", "approach", "lift"]


def test_lift_from_where_closing_pushed_the_arm_ends_where_the_plan_goes_on(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps((0.3, 0.1, -0.13))).plan
    assert plan is not None
    pushed = plan.trajectories["approach"].end + np.array([0.01, -0.08, 0.05, 0.02, -0.03, 0.04])
    lift = planner.plan_lift(pushed, plan)
    np.testing.assert_allclose(lift.positions[0], pushed, atol=1e-9)
    np.testing.assert_allclose(lift.positions[-1], plan.trajectories["carry"].positions[0], atol=1e-6)
    assert np.abs(lift.velocities[[0, -1]]).max() < 1e-6, "at rest at both ends"


def test_the_nearest_branch_is_taken(planner: PickPlanner) -> None:
    first = planner.plan(at_home(), top_grasps(PLACE)).plan
    assert first is not None
    stand_off = first.trajectories["approach"].positions[0]
    again = planner.plan(ArmSituation(stand_off, HAND.open_hand), top_grasps(PLACE)).plan
    assert again is not None
    np.testing.assert_allclose(again.trajectories["approach"].positions[0], stand_off, atol=1e-6)
    assert np.abs(np.diff(again.trajectories["transfer"].positions, axis=0)).max() < 1e-6


def test_start_with_the_fingers_around_an_object_escapes_first(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps(PLACE)).plan
    assert plan is not None
    # Something close to the fingers: the cloud's voxels reach into them.
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.05))
    stuck = ArmSituation(plan.trajectories["approach"].end, plan.grasp.pre_grasp_joints, cloud=cloud)
    answer = planner.plan(stuck, top_grasps((0.25, -0.25, -0.09)))
    assert answer.plan is not None, answer.rejections
    assert list(answer.plan.trajectories)[0] == "escape"
    (home,) = planner.plan_home(at_home())
    np.testing.assert_allclose(home.end, HOME_ARM)
    assert len(planner.plan_home(stuck)) == 2


def test_way_with_a_load_lifts_it_off_the_table_first(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.03))
    plan = planner.plan(at_home(cloud), top_grasps(PLACE), keep_holding=True).plan
    assert plan is not None and plan.load.box is not None
    gripping, closed = plan.trajectories["approach"].end, plan.grasp.grasp_joints
    holding = ArmSituation(gripping, closed, cloud=cloud, load=plan.load)
    ways = planner.plan_home(holding)
    assert len(ways) == 2, "straight up, then home"
    tcp = np.array([planner.ik.tcp(q)[:3, 3] for q in ways[0].positions])
    assert np.ptp(tcp[:, :2], axis=0).max() < 2e-3 and tcp[-1, 2] - tcp[0, 2] > 0.05
    held = plan.load.box.holds(cloud.points, planner.ik.tcp(gripping))
    assert held.sum() > 0.9 * len(cloud.points)
    checker = PlanningScene(cloud).checker(closed, released=held, carried=plan.load.box)
    assert checker.first_collision(ways[1].positions) is None
    assert checker.in_collision(gripping), "on the table the load touches it"
    over_the_bin = planner.ik.tcp(planner.plan_to_bin(holding)[-1].end)
    middle = apply(over_the_bin, (plan.load.box.lower + plan.load.box.upper) / 2)
    np.testing.assert_allclose(middle[:2], CELL.bin_centre, atol=1e-6)


def test_start_nearer_than_the_clearance_is_no_collision() -> None:
    wide = PickPlanner(scene_settings=SceneSettings(arm_clearance=0.25))
    start = HOME_ARM + (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert PlanningScene(settings=wide.scene_settings).checker(HAND.open_hand).in_collision(start)
    assert (
        not PlanningScene(settings=SceneSettings(arm_clearance=0.0))
        .checker(HAND.open_hand)
        .in_collision(start)
    )
    (home,) = wide.plan_home(ArmSituation(start, HAND.open_hand))
    np.testing.assert_allclose(home.end, HOME_ARM)
    assert wide.plan(ArmSituation(start, HAND.open_hand), top_grasps(PLACE)).plan is not None


def test_start_nearer_to_the_cloud_than_the_transfer_keeps_is_planned_from(planner: PickPlanner) -> None:
    hand = planner.ik.tcp(HOME_ARM)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.02, 0.02, 9)] * 3), axis=-1).reshape(-1, 3)
    target = cylinder(0.3, 0.1)

    def with_block(ahead: float) -> ObstacleCloud:
        return ObstacleCloud.from_points(np.concatenate([grid + hand[:3, 3] + ahead * hand[:3, 2], target]))

    def free(cloud: ObstacleCloud) -> bool:
        scene = PlanningScene(cloud)
        return not any(
            scene.checker(shape).in_collision(HOME_ARM) for shape in (HAND.open_hand, HAND.pre_grasp(FINAL))
        )

    near = next(cloud for ahead in np.arange(0.05, 0.30, 0.005) if free(cloud := with_block(float(ahead))))
    wide = PlanningScene(near).checker(HAND.open_hand, cloud_clearance=0.03)
    assert wide.in_collision(HOME_ARM)
    far_off = PickPlanner(scene_settings=SceneSettings(transfer_clearance=0.03))
    assert far_off.plan(at_home(near), top_grasps((0.3, 0.1, -0.13))).plan is not None


def test_a_way_home_that_is_not_found_says_why(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps((0.3, 0.2, -0.09))).plan
    assert plan is not None
    over_table = plan.trajectories["transfer"].end
    block = np.stack(np.meshgrid(*[np.linspace(-0.09, 0.09, 46)] * 3), axis=-1).reshape(-1, 3)
    hasty = PickPlanner(planner.ik, PickSettings(path_time=0.0))
    at_the_end, half_way = "it would end where .* meets observed cloud", "its search ended after 0 s"
    for arm, said in ((HOME_ARM, at_the_end), ((over_table + HOME_ARM) / 2, half_way)):
        points = np.repeat(block + planner.ik.tcp(arm)[:3, 3], 2, axis=0)
        with refused(ErrorCode.NO_PATH, said):
            hasty.plan_home(ArmSituation(over_table, HAND.open_hand, cloud=ObstacleCloud.from_points(points)))


def test_start_inside_the_cell_is_refused(planner: PickPlanner) -> None:
    folded = np.array([0.0, -1.57, 3.0, 0.0, 0.0, 0.0])
    with refused(ErrorCode.NO_PATH, "starts in collision"):
        planner.plan(ArmSituation(folded, HAND.open_hand), top_grasps(PLACE))


def test_no_candidates(planner: PickPlanner) -> None:
    with refused(ErrorCode.NO_CANDIDATES):
        planner.plan(at_home(), GraspSet.empty())


def test_time_limit_ends_the_search(planner: PickPlanner) -> None:
    hasty = PickPlanner(planner.ik, PickSettings(planning_time=0.0))
    answer = hasty.plan(at_home(), top_grasps(np.tile(PLACE, (3, 1))))
    assert answer.plan is None and {r.code for r in answer.rejections} == {ErrorCode.NO_PATH}


def test_hand_joints_just_beyond_their_limits_are_clipped() -> None:
    slightly = replace(top_grasp(*PLACE), pre_grasp_joints=np.tile([-0.27, -0.01, -0.01, -0.01], 5))
    clipped = check_grasp(slightly)
    assert (HAND.split(clipped.pre_grasp_joints)[:, 1:] == 0.0).all()


@pytest.mark.parametrize("x", [0.25, 0.4])
def test_what_cannot_be_pushed_over_the_free_edge_can_be_pushed_towards_it(
    planner: PickPlanner, x: float
) -> None:
    points = slab(x, -0.25)
    cloud = ObstacleCloud.from_points(points)
    found = pushes(height_field(in_frame_table(points)), EDGE, PlannerParameters().push()).moved(
        CELL.T_base_table
    )
    along = np.abs(found.motion[:, 0]) < 0.01
    upright = ~along & (found.rotation[:, 2, 2] < -0.98)
    if upright.any():
        assert planner.plan(at_home(cloud), found[upright]).plan is None
        over_it = planner.plan(at_home(cloud), found[~along]).plan
        assert over_it is not None and over_it.grasp.rotation[2, 2] > -0.95, (
            "a leaning hand reaches behind it"
        )
    plan = planner.plan(at_home(cloud), found[along]).plan
    assert plan is not None and plan.grasp.motion[1] > 0.4


def test_what_is_held_at_its_end_is_let_go_over_the_middle_of_the_bin(planner: PickPlanner) -> None:
    box = CarriedBox(np.array([-0.02, 0.01, -0.01]), np.array([0.02, 0.15, 0.05]))
    poses = np.array([planner.ik.tcp(q) for q in release_states(planner.ik, box, HOME_ARM, planner.settings)])
    middles = poses[:, :3, :3] @ (0.0, 0.08, 0.02) + poses[:, :3, 3]
    np.testing.assert_allclose(middles[:, :2], np.tile(CELL.bin_centre, (len(poses), 1)), atol=1e-8)
    far = CarriedBox(box.lower, np.array([0.02, 0.60, 0.05]))
    for q in release_states(planner.ik, far, HOME_ARM, planner.settings):
        assert np.linalg.norm(planner.ik.tcp(q)[:2, 3] - CELL.bin_centre) < 0.1001


def test_from_over_the_bin_no_way_to_a_grasp_takes_a_turn_about_the_robot(planner: PickPlanner) -> None:
    bin_posture = release_states(planner.ik, None, HOME_ARM, planner.settings)[0]
    for x, y in ((0.25, -0.25), (0.3, 0.0), (0.4, 0.2), (0.25, 0.1)):
        situation = ArmSituation(bin_posture, HAND.open_hand, cloud=ObstacleCloud.from_points(cylinder(x, y)))
        plan = planner.plan(situation, top_grasps((x, y, -0.09))).plan
        assert plan is not None and plan.trajectories["transfer"].duration < 2.5
        assert plan.shaping_on_the_way


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

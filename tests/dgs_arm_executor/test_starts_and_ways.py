from __future__ import annotations

import numpy as np

from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.planning_scene import PlanningScene, SceneSettings
from dgs_arm_executor.release import release_states
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from tests.support.grasps import FINAL, top_grasps
from tests.support.picks import PLACE, at_home, cylinder, verify
from tests.support.refused import refused


def test_picks_from_any_free_start(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1))
    checker = PlanningScene(cloud).checker(HAND.open_hand)
    rng = np.random.default_rng(8)
    draws = HOME_ARM + rng.uniform(-1.0, 1.0, (60, 6)) * (2.5, 0.6, 0.6, 1.0, 1.0, 3.0)
    starts = [q for q in draws if not checker.in_collision(q)][:3]
    assert len(starts) == 3
    for start in starts:
        plan = planner.plan(ArmSituation(start, HAND.open_hand, cloud=cloud), top_grasps(PLACE)).chosen()
        verify(planner, plan, start, cloud)


def test_start_with_the_fingers_around_an_object_escapes_first(planner: PickPlanner) -> None:
    plan = planner.plan(at_home(), top_grasps(PLACE)).chosen()
    # Something close to the fingers: the cloud's voxels reach into them.
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.05))
    stuck = ArmSituation(plan.trajectories["approach"].end, plan.grasp.pre_grasp_joints, cloud=cloud)
    away = planner.plan(stuck, top_grasps((0.25, -0.25, -0.09))).chosen()
    assert next(iter(away.trajectories)) == "escape"
    (home,) = planner.plan_home(at_home())
    np.testing.assert_allclose(home.end, HOME_ARM)
    assert len(planner.plan_home(stuck)) == 2


def test_way_with_a_load_lifts_it_off_the_table_first(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.03))
    plan = planner.plan(at_home(cloud), top_grasps(PLACE), keep_holding=True).chosen()
    assert plan.load.box is not None
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
    middle = over_the_bin @ plan.load.box.T_tcp_box[:, 3]
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
    plan = planner.plan(at_home(), top_grasps((0.3, 0.2, -0.09))).chosen()
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


def test_from_over_the_bin_no_way_to_a_grasp_takes_a_turn_about_the_robot(planner: PickPlanner) -> None:
    bin_posture = release_states(planner.ik, None, HOME_ARM, planner.settings)[0]
    for x, y in ((0.25, -0.25), (0.3, 0.0), (0.4, 0.2), (0.25, 0.1)):
        situation = ArmSituation(bin_posture, HAND.open_hand, cloud=ObstacleCloud.from_points(cylinder(x, y)))
        plan = planner.plan(situation, top_grasps((x, y, -0.09))).chosen()
        assert plan.trajectories["transfer"].duration < 2.5
        assert plan.shaping_on_the_way

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_arm_executor.candidate_check import check_candidate
from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.pick_types import HOME, OPEN_HAND, Candidate, PickPlan, PickSettings
from dgs_arm_executor.planning_scene import PlanningScene, SceneSettings, Situation
from dgs_arm_executor.safety import Envelope, check_trajectory
from dgs_arm_executor.self_filter import without_robot
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import CELL, transform
from dgs_description.hand_model import pre_grasp

DOWN = np.diag([1.0, -1.0, -1.0])
GRASP = np.tile([0.0, 0.55, 0.4, 0.4], 5)


def candidate(index: int, x: float, y: float, z: float, tilt: float = 0.0, yaw: float = 0.0) -> Candidate:
    turn = Rotation.from_euler("z", yaw) * Rotation.from_euler("y", tilt)
    return Candidate(
        index, transform(turn.as_matrix() @ DOWN, (x, y, z)), pre_grasp(GRASP), GRASP, np.array([x, y, z])
    )


def cylinder(x: float, y: float, height: float = 0.09, radius: float = 0.025) -> np.ndarray:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 3000)
    z = CELL.table_height + rng.uniform(0, height, 3000)
    return np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), z], axis=1)


def verify(planner: PickPlanner, plan: PickPlan, start: np.ndarray, cloud: ObstacleCloud) -> None:
    """The stages join, each passes the safety check, and each is free at every sample, by fresh checkers."""
    scene, chosen = PlanningScene(cloud), plan.candidate
    released = cloud.target_mask(chosen.reference_point, chosen.T_base_tcp[:3, 3])
    situations = {
        "transfer": Situation(chosen.pre_grasp_joints, cloud_clearance=0.005),
        "approach": Situation(chosen.pre_grasp_joints, released),
        "lift": Situation(chosen.grasp_joints, released, hand_on_table=True),
        "carry": Situation(chosen.grasp_joints, released),
        "home": Situation(OPEN_HAND, released),
    }
    here = start
    for stage, trajectory in plan.trajectories.items():
        np.testing.assert_allclose(trajectory.positions[0], here, atol=1e-9)
        hand = situations[stage].hand_joints
        check_trajectory(trajectory.times, trajectory.positions, trajectory.velocities, here, hand)
        assert scene.checker(situations[stage]).first_collision(trajectory.positions) is None, stage
        here = trajectory.end
    forward = planner.ik.forward
    np.testing.assert_allclose(forward(plan.grasp) @ T_TOOL0_TCP, chosen.T_base_tcp, atol=1e-8)
    lifted = forward(plan.trajectories["lift"].end) @ T_TOOL0_TCP
    np.testing.assert_allclose(
        lifted[:3, 3] - chosen.T_base_tcp[:3, 3], (0, 0, planner.settings.lift), atol=1e-8
    )


def test_whole_picks_in_random_scenes(planner: PickPlanner) -> None:
    rng, planned = np.random.default_rng(5), 0
    for _ in range(4):
        places = rng.uniform((0.18, -0.3), (0.4, 0.3), (3, 2))
        cloud = ObstacleCloud.from_points(np.concatenate([cylinder(*place) for place in places]))
        grasps = [
            candidate(k, *places[k % 3], -0.09, rng.uniform(-0.5, 0.5), rng.uniform(0, 6.28))
            for k in range(8)
        ]
        answer = planner.plan(HOME, OPEN_HAND, grasps, cloud)
        refused = [rejection.index for rejection in answer.rejections]
        if answer.plan is None:
            assert refused == list(range(8))
            continue
        planned += 1
        assert refused == list(range(answer.plan.candidate.index))
        assert list(answer.plan.trajectories) == ["transfer", "approach", "lift", "carry", "home"]
        verify(planner, answer.plan, HOME, cloud)
        np.testing.assert_allclose(answer.plan.trajectories["home"].end, HOME, atol=1e-9)
        release = planner.ik.forward(answer.plan.trajectories["carry"].end) @ T_TOOL0_TCP
        np.testing.assert_allclose(release[:2, 3], CELL.bin_centre, atol=1e-8)
        assert release[2, 3] > CELL.table_height + CELL.bin_size[2] + 0.05
    assert planned >= 3


def test_picks_from_any_free_start(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1))
    checker = PlanningScene(cloud).checker(Situation(OPEN_HAND))
    rng = np.random.default_rng(8)
    draws = HOME + rng.uniform(-1.0, 1.0, (60, 6)) * (2.5, 0.6, 0.6, 1.0, 1.0, 3.0)
    starts = [q for q in draws if not checker.in_collision(q)][:3]
    assert len(starts) == 3
    for start in starts:
        answer = planner.plan(start, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)], cloud)
        assert answer.plan is not None, answer.rejections
        verify(planner, answer.plan, start, cloud)


def test_no_stage_leaves_the_box_that_the_safety_envelope_wants(planner: PickPlanner) -> None:
    upper = (0.45, 0.70, 1.00)
    boxed = PickPlanner(scene_settings=SceneSettings(tcp_upper=upper))
    cloud, far_out = ObstacleCloud.from_points(cylinder(0.38, 0.25)), [candidate(0, 0.38, 0.25, -0.09)]

    def refused(plan: PickPlan) -> list[str]:
        out, here = [], HOME
        for stage, way in plan.trajectories.items():
            hand = (
                plan.candidate.grasp_joints if stage in ("lift", "carry") else plan.candidate.pre_grasp_joints
            )
            try:
                check_trajectory(
                    way.times, way.positions, way.velocities, here, hand, Envelope(tcp_upper=upper)
                )
            except DgsError as error:
                assert error.code == ErrorCode.SAFETY_ENVELOPE
                out.append(stage)
            here = way.end
        return out

    plans = [p.plan(HOME, OPEN_HAND, far_out, cloud).plan for p in (planner, boxed)]
    assert plans[0] is not None and plans[1] is not None
    assert "transfer" in refused(plans[0]), "the shortest way swings out of the box"
    assert refused(plans[1]) == []
    beyond = planner.plan(HOME, OPEN_HAND, [candidate(0, 0.50, 0.0, -0.09)], cloud)
    assert beyond.plan is not None
    (rejection,) = boxed.plan(HOME, OPEN_HAND, [candidate(0, 0.50, 0.0, -0.09)], cloud).rejections
    assert rejection.code == ErrorCode.COLLISION_APPROACH and "leaves its box" in rejection.reason


def test_every_refused_candidate_has_its_reason(planner: PickPlanner) -> None:
    wall = np.random.default_rng(0).uniform((0.26, 0.03, -0.2), (0.34, 0.05, 0.1), (9000, 3))
    cloud = ObstacleCloud.from_points(np.concatenate([wall, cylinder(0.25, -0.25)]))
    nan = candidate(4, 0.3, 0.0, float("nan"))
    wild = replace(candidate(5, 0.3, 0.0, -0.1), grasp_joints=np.full(20, 3.0))
    shear = replace(candidate(6, 0.3, 0.0, -0.1), T_base_tcp=np.diag([1.0, 1.0, 2.0, 1.0]))
    grasps = [
        candidate(0, 0.9, 0.0, -0.1),
        candidate(1, 0.25, -0.25, -0.23),
        candidate(2, 0.3, 0.1, -0.09),
        candidate(3, 0.3, 0.0, -0.1, tilt=np.pi),
        nan,
        wild,
        shear,
        candidate(7, 0.25, -0.25, -0.09),
    ]
    answer = planner.plan(HOME, OPEN_HAND, grasps, cloud)
    codes = {rejection.index: rejection.code for rejection in answer.rejections}
    assert answer.plan is not None and answer.plan.candidate.index == 7
    assert codes[0] == ErrorCode.OUT_OF_REACH
    assert codes[1] == ErrorCode.COLLISION_APPROACH
    assert codes[2] in (ErrorCode.COLLISION_STAND_OFF, ErrorCode.COLLISION_APPROACH)
    assert codes[4] == codes[5] == codes[6] == ErrorCode.GRASP_INVALID
    assert all(len(rejection.reason) > 10 for rejection in answer.rejections)


def test_what_only_the_lift_meets_is_a_collision_on_the_lift(planner: PickPlanner) -> None:
    grasp = candidate(0, 0.25, -0.25, -0.09, tilt=0.3)
    blocks = [np.zeros((0, 3))]
    # Put something where the lifted hand would be but the one on its way to the grasp is not, branch after branch.
    for _ in range(8):
        answer = planner.plan(HOME, OPEN_HAND, [grasp], ObstacleCloud.from_points(np.concatenate(blocks)))
        if answer.plan is None:
            break
        lifted = planner.ik.forward(answer.plan.trajectories["lift"].end) @ T_TOOL0_TCP
        points = np.random.default_rng(0).uniform(lifted[:3, 3] - 0.15, lifted[:3, 3] + 0.15, (60000, 3))
        for q in np.concatenate(
            [answer.plan.trajectories[k].positions[-60::8] for k in ("transfer", "approach")]
        ):
            points = without_robot(points, q, grasp.pre_grasp_joints)
        points = without_robot(points, answer.plan.grasp, grasp.grasp_joints)
        blocks.append(points)
    assert answer.plan is None
    assert answer.rejections[0].code == ErrorCode.COLLISION_LIFT, answer.rejections
    assert "on the lift" in answer.rejections[0].reason and "observed cloud" in answer.rejections[0].reason


def test_keep_holding_ends_after_the_lift(planner: PickPlanner) -> None:
    answer = planner.plan(HOME, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)], keep_holding=True)
    assert answer.plan is not None and list(answer.plan.trajectories) == ["transfer", "approach", "lift"]


def test_lift_from_where_closing_pushed_the_arm_ends_where_the_plan_goes_on(planner: PickPlanner) -> None:
    plan = planner.plan(HOME, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.13)], ObstacleCloud()).plan
    assert plan is not None
    pushed = plan.grasp + np.array([0.01, -0.08, 0.05, 0.02, -0.03, 0.04])
    lift = planner.plan_lift(pushed, plan)
    np.testing.assert_allclose(lift.positions[0], pushed, atol=1e-9)
    np.testing.assert_allclose(lift.positions[-1], plan.trajectories["carry"].positions[0], atol=1e-6)
    assert np.abs(lift.velocities[[0, -1]]).max() < 1e-6, "at rest at both ends"


def test_the_nearest_branch_is_taken(planner: PickPlanner) -> None:
    first = planner.plan(HOME, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)]).plan
    assert first is not None
    again = planner.plan(first.stand_off, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)]).plan
    assert again is not None
    np.testing.assert_allclose(again.stand_off, first.stand_off, atol=1e-6)
    assert np.abs(np.diff(again.trajectories["transfer"].positions, axis=0)).max() < 1e-6


def test_start_with_the_fingers_around_an_object_escapes_first(planner: PickPlanner) -> None:
    grasp = candidate(0, 0.3, 0.1, -0.09)
    plan = planner.plan(HOME, OPEN_HAND, [grasp]).plan
    assert plan is not None
    # Something close to the fingers: the cloud's voxels reach into them.
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.05))
    answer = planner.plan(plan.grasp, grasp.pre_grasp_joints, [candidate(0, 0.25, -0.25, -0.09)], cloud)
    assert answer.plan is not None, answer.rejections
    assert list(answer.plan.trajectories)[0] == "escape"
    (home,) = planner.plan_home(HOME, OPEN_HAND)
    np.testing.assert_allclose(home.end, HOME)
    assert len(planner.plan_home(plan.grasp, grasp.pre_grasp_joints, cloud)) == 2


def test_way_home_with_a_load_lifts_it_off_the_table_first(planner: PickPlanner) -> None:
    cloud = ObstacleCloud.from_points(cylinder(0.3, 0.1, height=0.12, radius=0.03))
    plan = planner.plan(HOME, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)], cloud, keep_holding=True).plan
    assert plan is not None and plan.load.box is not None
    closed = plan.candidate.grasp_joints
    ways = planner.plan_home(plan.grasp, closed, cloud, plan.load)
    assert len(ways) == 2, "straight up, then home"
    tcp = np.array([(planner.ik.forward(q) @ T_TOOL0_TCP)[:3, 3] for q in ways[0].positions])
    assert np.ptp(tcp[:, :2], axis=0).max() < 2e-3 and tcp[-1, 2] - tcp[0, 2] > 0.05
    held = plan.load.box.holds(cloud.points, planner.ik.forward(plan.grasp) @ T_TOOL0_TCP)
    assert held.sum() > 0.9 * len(cloud.points)
    checker = PlanningScene(cloud).checker(Situation(closed, held, plan.load.box))
    assert checker.first_collision(ways[1].positions) is None
    assert checker.in_collision(plan.grasp), "on the table the load touches it"


def test_start_nearer_than_the_clearance_is_no_collision() -> None:
    wide = PickPlanner(scene_settings=SceneSettings(arm_clearance=0.25))
    start = HOME + (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert PlanningScene(settings=wide.scene_settings).checker(Situation(OPEN_HAND)).in_collision(start)
    assert not PlanningScene(settings=SceneSettings(arm_clearance=0.0)).in_collision(start, OPEN_HAND)
    (home,) = wide.plan_home(start, OPEN_HAND)
    np.testing.assert_allclose(home.end, HOME)
    assert wide.plan(start, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)]).plan is not None


def test_start_nearer_to_the_cloud_than_the_transfer_keeps_is_planned_from(planner: PickPlanner) -> None:
    hand = planner.ik.forward(HOME) @ T_TOOL0_TCP
    grid = np.stack(np.meshgrid(*[np.linspace(-0.02, 0.02, 9)] * 3), axis=-1).reshape(-1, 3)
    target = cylinder(0.3, 0.1)

    def with_block(ahead: float) -> ObstacleCloud:
        return ObstacleCloud.from_points(np.concatenate([grid + hand[:3, 3] + ahead * hand[:3, 2], target]))

    def free(cloud: ObstacleCloud) -> bool:
        scene = PlanningScene(cloud)
        return not any(scene.in_collision(HOME, shape) for shape in (OPEN_HAND, pre_grasp(GRASP)))

    near = next(cloud for ahead in np.arange(0.05, 0.30, 0.005) if free(cloud := with_block(float(ahead))))
    wide = PlanningScene(near).checker(Situation(OPEN_HAND, cloud_clearance=0.03))
    assert wide.in_collision(HOME)
    far_off = PickPlanner(scene_settings=SceneSettings(transfer_clearance=0.03))
    assert far_off.plan(HOME, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.13)], near).plan is not None


def test_start_inside_the_cell_is_refused(planner: PickPlanner) -> None:
    folded = np.array([0.0, -1.57, 3.0, 0.0, 0.0, 0.0])
    with pytest.raises(DgsError, match="starts in collision") as caught:
        planner.plan(folded, OPEN_HAND, [candidate(0, 0.3, 0.1, -0.09)])
    assert caught.value.code == ErrorCode.NO_PATH


def test_no_candidates(planner: PickPlanner) -> None:
    with pytest.raises(DgsError) as caught:
        planner.plan(HOME, OPEN_HAND, [])
    assert caught.value.code == ErrorCode.NO_CANDIDATES


def test_time_limit_ends_the_search(planner: PickPlanner) -> None:
    hasty = PickPlanner(planner.ik, PickSettings(time_limit=0.0))
    answer = hasty.plan(HOME, OPEN_HAND, [candidate(k, 0.3, 0.1, -0.09) for k in range(3)])
    assert answer.plan is None and {r.code for r in answer.rejections} == {ErrorCode.NO_PATH}


def test_hand_joints_just_beyond_their_limits_are_clipped() -> None:
    slightly = replace(candidate(0, 0.3, 0.1, -0.09), pre_grasp_joints=np.full(20, -0.01))
    slightly.pre_grasp_joints[::4] = -0.27
    clipped = check_candidate(slightly)
    assert (clipped.pre_grasp_joints.reshape(5, 4)[:, 1:] == 0.0).all()

from __future__ import annotations

import numpy as np
import pytest

from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.grasp import GraspSet
from dgs_description.pick import RETREAT
from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.propose.drag import drags
from dgs_grasp_planner.propose.edge_pinch import edge_pinches
from dgs_grasp_planner.propose.push import pushes
from dgs_grasp_planner.propose.turn_over import turns_over
from tests.dgs_grasp_planner.propose.test_drag import knife
from tests.dgs_grasp_planner.propose.test_turn_over import bowl
from tests.dgs_grasp_planner.scenes import field_of
from tests.support.picks import EDGE, at_home, in_frame_table, slab, verify


def planned(planner: PickPlanner, points: np.ndarray, grasps: GraspSet, *stages: str) -> PickPlan:
    """The plan, of these stages, of grasps in frame *table* for a thing of points (N, 3) in `base_link`."""
    cloud = ObstacleCloud.from_points(points)
    plan = planner.plan(at_home(cloud), grasps.moved(CELL.T_base_table)).chosen()
    assert list(plan.trajectories) == ["transfer", "approach", "advance", *stages]
    verify(planner, plan, HOME_ARM, cloud)
    return plan


@pytest.mark.parametrize("y", [0.2, 0.3])
def test_what_sticks_out_over_the_edge_is_pinched_from_outside(planner: PickPlanner, y: float) -> None:
    points = slab(CELL.table_edge, y)
    pinches = edge_pinches(height_field(in_frame_table(points)), EDGE)
    plan = planned(planner, points, pinches, "lift", "carry", "home")
    lowest = planner.ik.tcp(plan.trajectories["advance"].end)[2, 3]
    assert lowest < CELL.table_height + 0.05


@pytest.mark.parametrize("y", [-0.3, -0.2, 0.3])
def test_a_push_moves_on_goes_up_and_home_with_nothing(planner: PickPlanner, y: float) -> None:
    points = slab(0.3, y)
    found = pushes(height_field(in_frame_table(points)), EDGE)
    plan = planned(planner, points, found, "retreat", "lift", "home")
    way = planner.ik.tcp(plan.trajectories["advance"].end) - planner.ik.tcp(plan.trajectories["approach"].end)
    np.testing.assert_allclose(way[:3, 3], plan.grasp.motion, atol=1e-8)
    back = planner.ik.tcp(plan.trajectories["retreat"].end) - planner.ik.tcp(plan.trajectories["advance"].end)
    np.testing.assert_allclose(back[:3, 3], -RETREAT * way[:3, 3] / np.linalg.norm(way[:3, 3]), atol=1e-8)
    off = plan.trajectories["retreat"].positions[0] + np.array([0.01, -0.02, 0.02, 0.01, -0.01, 0.02])
    retreat = planner.plan_off(off, plan, "retreat")
    np.testing.assert_allclose(retreat.positions[0], off, atol=1e-9)
    np.testing.assert_allclose(retreat.positions[-1], plan.trajectories["lift"].positions[0], atol=1e-6)


@pytest.mark.parametrize("y", [0.2, 0.3])
def test_a_drag_moves_on_with_the_hand_closed_and_goes_up_and_home_as_it_came(
    planner: PickPlanner, y: float
) -> None:
    points = knife(x=0.3, height=0.014) + (0, y, CELL.table_height)
    found = drags(height_field(in_frame_table(points)), EDGE)
    plan = planned(planner, points, found, "lift", "home")
    assert plan.grasp.drags
    way = planner.ik.tcp(plan.trajectories["advance"].end) - planner.ik.tcp(plan.trajectories["approach"].end)
    np.testing.assert_allclose(way[:3, 3], plan.grasp.motion, atol=1e-8)


@pytest.mark.parametrize("y", [0.3, 0.32, 0.34])
def test_the_arm_turns_over_what_lies_where_domes_are_pushed(planner: PickPlanner, y: float) -> None:
    assert CELL.turning_edge[0] < y < CELL.turning_edge[1]
    points = bowl(EDGE + 0.02, y - CELL.workspace_centre[1])
    found = turns_over(field_of(points), EDGE)
    planned(planner, points + CELL.T_base_table[:3, 3], found, "retreat", "lift", "home")


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
        over_it = planner.plan(at_home(cloud), found[~along]).chosen()
        assert over_it.grasp.rotation[2, 2] > -0.95, "a leaning hand reaches behind it"
    plan = planner.plan(at_home(cloud), found[along]).chosen()
    assert plan.grasp.motion[1] > 0.4

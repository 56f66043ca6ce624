from __future__ import annotations

from dgs_arm_executor.pick_planner import PickPlanner
from dgs_learning.planning.baseline import Baseline
from tests.dgs_learning.planning.cells import AT_HOME, PLACE, grasps_at


def test_baseline_takes_the_first_grasp_that_it_reaches() -> None:
    grasps = grasps_at((0.9, 0.0, -0.09), (*PLACE, -0.09))
    baseline = Baseline(PickPlanner(), AT_HOME)
    assert baseline.to_stand_off(grasps) == 1
    assert baseline.whole_pick(grasps) == 1
    assert baseline.whole_pick(grasps[:1]) is None

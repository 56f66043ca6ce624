"""When the camera sees the workspace and not the robot."""

from __future__ import annotations

import numpy as np

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.release import release_states
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_arm_executor.view import time_out_of_view, view_checker
from dgs_description.cell import HOME_ARM
from dgs_description.hand import HAND
from tests.support.grasps import top_grasps
from tests.support.picks import carried_box

GRASP = top_grasps(np.array([0.3, 0.1, -0.05]))[0]
SMALL = carried_box((-0.02, -0.02, -0.02), (0.02, 0.02, 0.02))


def over_the_table(ik: ArmIK) -> np.ndarray:
    return ik.states(GRASP.pose, HOME_ARM)[0]


def over_the_bin(ik: ArmIK) -> np.ndarray:
    return release_states(ik, SMALL, over_the_table(ik), PickSettings())[0]


def carry(ik: ArmIK) -> Trajectory:
    return time_path(SmoothPath.line(over_the_table(ik), over_the_bin(ik)), 0.4)


def carried_out_of_view(way: Trajectory, box: CarriedBox) -> float:
    return time_out_of_view(way, GRASP.grasp_joints, HAND.open_hand, box)


def test_home_and_the_bin_are_out_of_view_and_the_table_is_not(ik: ArmIK) -> None:
    checker = view_checker(HAND.open_hand)
    assert not checker.in_collision(HOME_ARM)
    assert not any(checker.in_collision(q) for q in release_states(ik, None, HOME_ARM, PickSettings()))
    assert checker.in_collision(over_the_table(ik))


def test_the_way_to_the_bin_is_out_of_view_from_some_time_on(ik: ArmIK) -> None:
    way = carry(ik)
    time = carried_out_of_view(way, SMALL)
    assert 0.0 < time < way.duration
    checker = view_checker(GRASP.grasp_joints, SMALL)
    assert [checker.in_collision(q) for q in way.positions[way.times >= time]].count(True) == 0
    assert checker.in_collision(way.positions[way.times < time][-1])


def test_a_long_object_is_in_view_for_longer_and_a_huge_one_for_ever(ik: ArmIK) -> None:
    way = carry(ik)
    long = carried_box((-0.15, -0.15, -0.02), (0.15, 0.15, 0.1))
    assert carried_out_of_view(way, long) > carried_out_of_view(way, SMALL)
    huge = carried_box((-0.6, -0.6, -0.6), (0.6, 0.6, 0.6))
    assert carried_out_of_view(way, huge) == np.inf


def test_a_way_that_ends_over_the_table_never_is(ik: ArmIK) -> None:
    back = time_path(SmoothPath.line(over_the_bin(ik), over_the_table(ik)), 0.4)
    assert carried_out_of_view(back, SMALL) == np.inf

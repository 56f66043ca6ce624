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
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import transform
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


def test_a_hand_before_the_camera_or_beside_the_table_is_in_view(ik: ArmIK) -> None:
    eye, low = CELL.T_base_camera_optical[:3, 3], CELL.workspace_bounds[0]
    level, down = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]), np.diag([1.0, -1.0, -1.0])
    half_way = (CELL.T_base_table[:3, 3] + eye) / 2
    beside = np.array([low[0] - 0.08, np.mean(CELL.free_edge), CELL.table_height + 0.1])
    for turn, place in ((level, half_way), (down, beside)):
        checker = view_checker(HAND.open_hand)
        (q, *_) = ik.states(transform(turn, place), HOME_ARM)
        assert checker.in_collision(q)
        assert {part for pair in checker.contacts(q) for part in pair} >= {"hand", "view"}


def test_a_hand_that_opens_into_the_view_at_the_end_of_a_way_is_not_out_of_it(ik: ArmIK) -> None:
    fist = np.tile([0.0, 1.2, 1.0, 1.0], 5)
    closed, opened = view_checker(fist), view_checker(HAND.open_hand)
    near = over_the_bin(ik) + np.random.default_rng(0).uniform(-0.8, 0.8, (2000, 6))
    edge = next(q for q in near if opened.in_collision(q) and not closed.in_collision(q))
    way = time_path(SmoothPath.line(over_the_bin(ik), edge), 0.4)
    assert time_out_of_view(way, fist, HAND.open_hand) == np.inf
    assert time_out_of_view(way, fist, fist) < np.inf


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

from __future__ import annotations

import numpy as np
import pytest

from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.release import release_states
from dgs_arm_executor.situation import Load
from dgs_description.frames import CELL, HOME_ARM
from tests.support.grasps import top_grasps
from tests.support.picks import carried_box


def released_at(planner: PickPlanner, box: CarriedBox, y: float) -> np.ndarray:
    """(K, 4, 4) poses of the TCP over the bin with what lay at (0.3, y)."""
    load = Load(top_grasps(np.array([0.3, y, -0.05]))[0], box)
    states = release_states(planner.ik, load, HOME_ARM, planner.settings)
    return np.array([planner.ik.tcp(q) for q in states])


@pytest.mark.parametrize(("length", "aside"), [(0.05, 0.07), (0.14, 0.06)])
def test_what_is_held_at_its_end_is_let_go_over_the_bins_two_halves_in_turn(
    planner: PickPlanner, length: float, aside: float
) -> None:
    box = carried_box((-0.02, 0.01, -0.01), (0.02, 0.01 + length, 0.05))
    for side in (-1, 1):
        poses = released_at(planner, box, 0.1 * side)
        middles = poses[:, :3, :3] @ (0.0, 0.01 + length / 2, 0.02) + poses[:, :3, 3]
        away = middles[:, :2] - CELL.bin_centre
        along_the_bin = np.abs(poses[:, 0, 1]) > 0.99
        hand_near = np.linalg.norm(poses[:, :2, 3] - CELL.bin_centre, axis=1) < 0.0999
        fits = away[along_the_bin & hand_near]
        np.testing.assert_allclose(fits, np.tile((side * aside, 0.0), (len(fits), 1)), atol=1e-8)
        assert len(fits)
        assert (side * away[hand_near, 0] > -1e-9).all() and (np.abs(away[hand_near]) < 0.0701).all()


def test_the_hand_itself_stays_near_the_bins_middle(planner: PickPlanner) -> None:
    poses = released_at(planner, carried_box((-0.02, 0.01, -0.01), (0.02, 0.60, 0.05)), 0.1)
    assert (np.linalg.norm(poses[:, :2, 3] - CELL.bin_centre, axis=1) < 0.1001).all()

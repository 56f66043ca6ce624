from __future__ import annotations

import numpy as np

from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.release import release_states
from dgs_description.cell import CELL, HOME_ARM
from tests.support.picks import carried_box


def test_what_is_held_at_its_end_is_let_go_over_the_middle_of_the_bin(planner: PickPlanner) -> None:
    box = carried_box((-0.02, 0.01, -0.01), (0.02, 0.15, 0.05))
    poses = np.array([planner.ik.tcp(q) for q in release_states(planner.ik, box, HOME_ARM, planner.settings)])
    middles = poses[:, :3, :3] @ (0.0, 0.08, 0.02) + poses[:, :3, 3]
    np.testing.assert_allclose(middles[:, :2], np.tile(CELL.bin_centre, (len(poses), 1)), atol=1e-8)
    far = carried_box((-0.02, 0.01, -0.01), (0.02, 0.60, 0.05))
    states = release_states(planner.ik, far, HOME_ARM, planner.settings)
    assert (np.diff(np.abs(states - HOME_ARM).max(axis=1)) >= 0.0).all(), "nearest first"
    for q in states:
        assert np.linalg.norm(planner.ik.tcp(q)[:2, 3] - CELL.bin_centre) < 0.1001

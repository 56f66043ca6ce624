from __future__ import annotations

import numpy as np

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.release import lowering, release_states
from dgs_description.frames import CELL, HOME_ARM
from tests.support.picks import carried_box


def test_what_is_held_at_its_end_is_let_go_over_the_middle_of_the_bin(planner: PickPlanner) -> None:
    box = carried_box((-0.02, 0.01, -0.01), (0.02, 0.15, 0.05))
    poses = np.array([planner.ik.tcp(q) for q in release_states(planner.ik, box, HOME_ARM, planner.settings)])
    middles = poses[:, :3, :3] @ (0.0, 0.08, 0.02) + poses[:, :3, 3]
    np.testing.assert_allclose(middles[:, :2], np.tile(CELL.bin_centre, (len(poses), 1)), atol=1e-8)
    far = carried_box((-0.02, 0.01, -0.01), (0.02, 0.60, 0.05))
    for q in release_states(planner.ik, far, HOME_ARM, planner.settings):
        assert np.linalg.norm(planner.ik.tcp(q)[:2, 3] - CELL.bin_centre) < 0.1001


def test_what_hangs_down_is_lowered_between_the_walls_where_it_fits_in(planner: PickPlanner) -> None:
    def ways(half_width: float, length: float) -> np.ndarray:
        """By pose over the bin, of what hangs down from the fingers."""
        box = carried_box((-half_width, -0.02, -0.03), (half_width, 0.02, length))
        states = release_states(planner.ik, box, HOME_ARM, planner.settings)
        poses = planner.ik.forward_many(states) @ T_TOOL0_TCP
        down = lowering(poses, box, planner.settings)
        bottom = poses[:, 2, 3] - length - down - CELL.table_height - CELL.bin_size[2]
        assert (bottom[down > 0] > -0.0501).all() and (poses[:, 2, 3] - down > 0.06 - 0.05).all()
        return down

    assert (ways(0.03, 0.05) == 0).all(), "nothing hangs"
    assert (ways(0.03, 0.16) > 0.09).all(), "it fits whatever way it is turned"
    some = ways(0.115, 0.16) > 0
    assert some.any() and not some.all(), "along the bin, not across"
    assert (ways(0.15, 0.16) == 0).all()

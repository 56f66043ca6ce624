"""How far back the hand goes from what it has pushed."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.grasp import GraspSet
from dgs_description.pick import RETREAT, way_back


@pytest.mark.parametrize(("pushed", "back"), [(0.2, RETREAT), (0.02, 0.02)])
def test_the_hand_goes_back_level_and_no_farther_than_it_came(pushed: float, back: float) -> None:
    push = GraspSet.of(
        "push",
        position=np.zeros(3),
        rotation=np.eye(3),
        pre_grasp_joints=np.zeros(20),
        grasp_joints=np.zeros(20),
        active_fingers=False,
        motion=(-0.6 * pushed, 0.8 * pushed, 0.0),
    )[0]
    np.testing.assert_allclose(way_back(push), (0.6 * back, -0.8 * back, 0.0), atol=1e-12)

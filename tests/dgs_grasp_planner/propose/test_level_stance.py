"""The hand of a level pinch: balls on one line, equally deep, whatever way the pinch stands."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_grasp_planner.propose.level_stance import ACTIVE, LEAN, hand_axes, level_stance, open_stance

UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize(("across", "ahead"), [(UP, AHEAD), (AHEAD, -UP)])
def test_thumb_and_fingers_lie_on_both_sides_equally_deep(across: np.ndarray, ahead: np.ndarray) -> None:
    axes = hand_axes(across, ahead, LEAN)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    stance = level_stance(0.015, LEAN, 0.009)
    for joints, room in ((stance.before, 0.009), (stance.final, 0.0)):
        balls = (HAND.end_balls(joints) - stance.middle)[ACTIVE] @ axes.T
        np.testing.assert_allclose(balls @ ahead, 0.0, atol=0.001)
        wanted = (0.0075 + HAND.ball_radius + room) * np.array([1, -1, -1, -1])
        np.testing.assert_allclose(balls @ across, wanted, atol=0.002)


def test_equal_widths_share_one_solution() -> None:
    assert level_stance(0.0151, LEAN, 0.009) is level_stance(0.0149, LEAN, 0.009)


@pytest.mark.parametrize("thick", [0.006, 0.03, 0.05, 0.075])
def test_an_open_hand_closes_until_it_touches_and_no_farther(thick: float):
    wanted = 0.045
    stance, depth = open_stance(thick, LEAN, wanted)
    across, ahead = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    placed = (HAND.finger_spheres(stance.final) - stance.middle) @ hand_axes(across, ahead, LEAN).T
    beside = placed[..., 2] <= -min(depth, wanted)
    gap = np.where(beside, np.inf, abs(placed[..., 0]) - thick / 2 - HAND.sphere_radii).min(axis=1)[ACTIVE]
    assert gap.min() > -0.0005, "nothing is inside of the thing"
    assert gap[0] < 0.002 and np.sort(gap[1:])[1] < 0.002, "thumb and two fingers are at it"

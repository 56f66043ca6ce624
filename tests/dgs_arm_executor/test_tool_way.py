"""The tool's speed limit in timing and in the choice of ways."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_arm_executor.ik import T_TOOL0_TCP, ArmIK
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_arm_executor.tool_way import least_times, time_free_path
from dgs_description.cell import HOME_ARM
from dgs_description.joints import TOOL_SPEED

STRETCHED = np.array([-1.7, -0.6, 0.3, -1.4, -1.57, 0.0])


def tool_speed(ik: ArmIK, trajectory: Trajectory) -> float:
    places = (ik.forward_many(trajectory.positions) @ T_TOOL0_TCP)[:, :3, 3]
    return float((np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(trajectory.times)).max())


def test_the_tool_keeps_to_its_speed_and_uses_it(ik: ArmIK) -> None:
    path = SmoothPath.line(STRETCHED, STRETCHED + (3.0, 0, 0, 0, 0, 0))
    assert tool_speed(ik, time_path(path)) > 1.2 * TOOL_SPEED
    assert tool_speed(ik, time_free_path(ik, path, 1.0)) == pytest.approx(TOOL_SPEED, rel=0.02)


def test_where_the_tool_is_slow_anyway_nothing_changes(ik: ArmIK) -> None:
    path = SmoothPath.line(HOME_ARM, HOME_ARM + (0, 0, 0, 0, 0, 2.0))
    assert time_free_path(ik, path, 1.0).duration == pytest.approx(time_path(path).duration)


def test_staying_where_one_is_takes_no_time(ik: ArmIK) -> None:
    assert time_free_path(ik, SmoothPath.line(HOME_ARM, HOME_ARM), 1.0).duration < 0.05


def test_the_least_time_is_a_bound_and_not_far_off(ik: ArmIK) -> None:
    rng = np.random.default_rng(0)
    states = HOME_ARM + rng.uniform(-1.5, 1.5, (20, 6))
    least = least_times(ik, HOME_ARM, states)
    taken = [time_free_path(ik, SmoothPath.line(HOME_ARM, q), 1.0).duration for q in states]
    assert (least < taken).all()
    assert (np.array(taken) < 2.0 * least + 0.3).all()

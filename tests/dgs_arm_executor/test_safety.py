from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_arm_executor.ik import T_TCP_TOOL0, ArmIK
from dgs_arm_executor.safety import Envelope, check_trajectory
from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from tests.support.refused import refused

OPEN = np.zeros(20)
END = HOME_ARM + np.array([0.5, 0.1, -0.2, 0.1, 0.0, 0.3])
ENVELOPE = Envelope()


@pytest.fixture(scope="module")
def good() -> Trajectory:
    return time_path(SmoothPath.line(HOME_ARM, END), 0.6)


def check(trajectory: Trajectory, measured: np.ndarray = HOME_ARM, envelope: Envelope = ENVELOPE) -> None:
    arrays = trajectory.times, trajectory.positions, trajectory.velocities
    check_trajectory(*arrays, measured, OPEN, envelope)


def unsafe(trajectory: Trajectory, match: str, measured: np.ndarray = HOME_ARM) -> None:
    with refused(ErrorCode.SAFETY_ENVELOPE, match):
        check(trajectory, measured)


def test_a_planned_trajectory_passes(good: Trajectory) -> None:
    check(good)
    check(good, HOME_ARM + 0.01)


def test_two_turns_at_the_least_speed_that_is_allowed_pass() -> None:
    back, forth = HOME_ARM.copy(), HOME_ARM.copy()
    back[0], forth[0] = -6.2, 6.2
    slow = time_path(SmoothPath.line(back, forth), 0.05)
    assert slow.duration > 75.0
    check(slow, back)


def test_start_away_from_the_measured_state(good: Trajectory) -> None:
    unsafe(good, "starts 0.100 rad away from the measured elbow", HOME_ARM + [0, 0, 0.1, 0, 0, 0])


def test_too_fast(good: Trajectory) -> None:
    unsafe(replace(good, times=good.times / 10), "times its velocity limit")
    unsafe(replace(good, velocities=good.velocities * 20), "times its velocity limit")


def test_too_hard(good: Trajectory) -> None:
    unsafe(replace(good, times=good.times * 0.8, velocities=good.velocities / 0.8), "accelerates")


def test_not_at_rest_at_the_end(good: Trajectory) -> None:
    unsafe(
        Trajectory(good.times[:20], good.positions[:20], good.velocities[:20], good.accelerations[:20]),
        "rest",
    )


@pytest.mark.parametrize("field", ["times", "positions", "velocities"])
def test_not_finite(good: Trajectory, field: str) -> None:
    values = getattr(good, field).copy()
    values[3] = np.nan
    unsafe(replace(good, **{field: values}), "not finite")


def test_times_and_shapes(good: Trajectory) -> None:
    unsafe(replace(good, times=good.times[::-1].copy()), "times that do not increase")
    unsafe(replace(good, times=good.times + 0.1), "times that do not increase")
    unsafe(replace(good, times=good.times[:-1]), "shapes")
    unsafe(replace(good, times=good.times * 1000), "300 s are allowed")


def test_beyond_a_joint_limit() -> None:
    start = HOME_ARM.copy()
    start[5] = 6.2
    path = SmoothPath.line(start, start + [0, 0, 0, 0, 0, 0.3])
    unsafe(time_path(path), "wrist_3_joint 0.217 rad beyond", start)


def test_hand_through_the_table_and_out_of_its_box(ik: ArmIK) -> None:
    down = np.diag([1.0, -1.0, -1.0])
    above, below = (
        ik.branches(transform(down, (0.3, 0.1, CELL.table_height + z)) @ T_TCP_TOOL0)[0][2]
        for z in (0.12, 0.01)
    )
    unsafe(time_path(SmoothPath.line(above, below)), "mm below the table top", above)
    check(time_path(SmoothPath.line(above, HOME_ARM)), above)
    touching = ik.states(transform(down, (0.3, 0.1, CELL.table_height + 0.053)), above)[0]
    still = time_path(SmoothPath.line(touching, touching))
    check(still, touching)
    with refused(ErrorCode.SAFETY_ENVELOPE, "11 mm below the table top"):
        check(still, touching, Envelope(table_penetration=0.0))
    for smaller in (Envelope(tcp_lower=(0.0, 0.0, -1.0)), Envelope(tcp_upper=(0.2, 1.0, 1.0))):
        with pytest.raises(DgsError, match="outside of its box"):
            check(time_path(SmoothPath.line(above, HOME_ARM)), above, smaller)


def test_the_back_of_a_level_hand_counts_as_its_fingers_do(ik: ArmIK) -> None:
    on_its_back = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    q = ik.states(transform(on_its_back, (0.35, 0.1, CELL.table_height + 0.06)), HOME_ARM)[0]
    still = time_path(SmoothPath.line(q, q))
    with refused(ErrorCode.SAFETY_ENVELOPE, "24 mm below the table top"):
        check(still, q)

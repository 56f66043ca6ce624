from __future__ import annotations

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st

from dgs_arm_executor.smooth_path import SmoothPath
from dgs_arm_executor.timing import Trajectory, anchored, joined_profile, time_path
from dgs_description.errors import ErrorCode
from dgs_description.joints import ARM_ACCELERATION, ARM_JERK, ARM_LOWER, ARM_UPPER, ARM_VELOCITY
from tests.support.refused import refused

state = st.tuples(*(st.floats(low, high) for low, high in zip(ARM_LOWER, ARM_UPPER, strict=True))).map(
    np.array
)
"""Any joints within the limits of the arm [rad]."""
speed = st.floats(0.05, 1.0)
FINE = 1000.0
"""Samples per second for checks by differences [Hz]."""


def check(trajectory: Trajectory, start: np.ndarray, end: np.ndarray, share: float = 1.0) -> None:
    """Limits by the stated values and by differences of the samples; ends; time."""
    t, q, dq, ddq = trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations
    assert t[0] == 0.0 and (np.diff(t) > 0).all()
    np.testing.assert_allclose(q[0], start, atol=1e-9)
    np.testing.assert_allclose(q[-1], end, atol=1e-9)
    assert (dq[[0, -1]] == 0).all() and (ddq[[0, -1]] == 0).all()
    assert (np.abs(dq) <= ARM_VELOCITY * share * (1 + 1e-9)).all()
    assert (np.abs(ddq) <= ARM_ACCELERATION * (1 + 1e-6)).all()
    step = np.diff(t)[:, None]
    assert (np.abs(np.diff(q, axis=0) / step) <= ARM_VELOCITY * share * (1 + 1e-6)).all()
    assert (np.abs(np.diff(dq, axis=0) / step) <= ARM_ACCELERATION * (1 + 1e-4)).all()
    assert (np.abs(np.diff(ddq, axis=0) / step) <= ARM_JERK * 1.005).all()


def check_positions(trajectory: Trajectory) -> None:
    """Between states within the joint limits nothing leaves them."""
    assert (trajectory.positions >= ARM_LOWER - 1e-9).all() and (
        trajectory.positions <= ARM_UPPER + 1e-9
    ).all()


def test_points_on_the_straight_between_two_corners_are_no_corners() -> None:
    a, b, c = (
        np.zeros(6),
        np.array([1.0, -1.0, 0.3, 0.0, 0.2, 0.1]),
        np.array([1.0, 0.5, 1.3, 0.7, 0.2, -0.1]),
    )
    shares = np.linspace(0.0, 1.0, 8)[:, None]
    dense = np.concatenate([a + shares * (b - a), b + shares[1:] * (c - b)])
    path = SmoothPath.rounded(dense, 0.3)
    assert len(path.curve.x) == len(SmoothPath.rounded(np.stack([a, b, c]), 0.3).curve.x)
    check(time_path(path, rate=FINE), a, c)


@settings(max_examples=40, deadline=None)
@given(state, state, speed)
def test_line_between_any_states_at_any_speed(start: np.ndarray, end: np.ndarray, share: float) -> None:
    path = SmoothPath.line(start, end)
    trajectory = time_path(path, share, 500.0)
    check(trajectory, start, end, share)
    check_positions(trajectory)


@settings(max_examples=25, deadline=None)
@given(st.lists(state, min_size=3, max_size=5), speed, st.floats(0.02, 0.8))
def test_rounded_polyline_through_any_states(points: list[np.ndarray], share: float, blend: float) -> None:
    path = SmoothPath.rounded(np.array(points), blend)
    trajectory = time_path(path, share, 200.0)
    check(trajectory, path(0.0), path(path.length), share)
    check_positions(trajectory)
    np.testing.assert_allclose(trajectory.positions[0], points[0], atol=1e-9)
    np.testing.assert_allclose(trajectory.end, points[-1], atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(state, state, state, speed)
def test_curved_path_through_any_samples(
    offset: np.ndarray, amplitude: np.ndarray, slope: np.ndarray, share: float
) -> None:
    s = np.linspace(0.0, 1.0, 25)
    samples = offset + 0.3 * amplitude * np.sin(3 * s)[:, None] + slope * s[:, None] ** 2 + 0.1 * s[:, None]
    path = SmoothPath.through(samples, s)
    check(time_path(path, share, 200.0), samples[0], samples[-1], share)


def test_profile_is_ruckigs_own() -> None:
    runs: list = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        request = ruckig.InputParameter(1)
        request.current_position, request.target_position = [0.0], [float(rng.uniform(0.5, 2.0))]
        request.current_velocity, request.target_velocity = (
            [float(rng.uniform(0, 1.2))],
            [float(rng.uniform(0, 0.3))],
        )
        request.max_velocity, request.max_acceleration, request.max_jerk = (
            [1.0],
            [2.0],
            [float(rng.uniform(5, 50))],
        )
        run = ruckig.Trajectory(1)
        ruckig.Ruckig(1).calculate(request, run)
        times = np.linspace(0.0, run.duration, 200)
        expected = np.array([[value[0] for value in run.at_time(t)] for t in times])
        profile = joined_profile([run])
        found = np.stack([profile(times, order) for order in range(3)], axis=1)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        runs += [run, (0.25, 0.5)]
    whole = joined_profile(runs)
    assert whole.x[-1] == pytest.approx(sum(run.duration for run in runs[::2]) + 40 * 0.5)
    steps = np.diff(whole(np.linspace(0.0, whole.x[-1], 5000)))
    assert (steps > -1e-9).all()


def test_line_is_as_fast_as_the_limits_allow() -> None:
    far = time_path(SmoothPath.line(np.zeros(6), np.array([3.0, 0, 0, 0, 0, 0])), 1.0, FINE)
    reached = (
        np.abs(far.velocities).max(0)[0] / ARM_VELOCITY[0],
        np.abs(far.accelerations).max(0)[0] / ARM_ACCELERATION[0],
    )
    assert max(reached) > 0.99
    slow = time_path(SmoothPath.line(np.zeros(6), np.array([3.0, 0, 0, 0, 0, 0])), 0.1, FINE)
    assert np.abs(slow.velocities).max() == pytest.approx(0.1 * np.pi, rel=2e-3)


def test_path_speed_is_bounded() -> None:
    path = SmoothPath.through(np.linspace(0, 0.3, 10)[:, None] * np.ones(6), np.linspace(0, 0.1, 10))
    trajectory = time_path(path, 1.0, 200.0, max_path_speed=0.02)
    assert np.abs(trajectory.velocities).max() <= 0.02 * 3.0 * 1.01
    assert trajectory.duration > 0.1 / 0.02


def test_no_way_is_a_short_hold() -> None:
    hold = time_path(SmoothPath.line(np.ones(6), np.ones(6)))
    assert hold.duration > 0 and (hold.positions == 1.0).all() and (hold.velocities == 0.0).all()


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, float("nan")])
def test_the_speed_must_be_a_share_of_the_limits(share: float) -> None:
    with refused(ErrorCode.ARM_INTERNAL):
        time_path(SmoothPath.line(np.zeros(6), np.ones(6)), share)


def test_rounded_corner_stays_close_and_smooth() -> None:
    points = np.zeros((3, 6))
    points[1, 0] = points[2, 0] = points[2, 1] = 1.0
    path = SmoothPath.rounded(points, 0.3)
    s = np.linspace(0, path.length, 2001)
    q = path(s)
    distance = np.minimum(np.hypot(q[:, 1], 0), np.abs(q[:, 0] - 1))
    assert 0.02 < distance.max() < 0.3 * np.sqrt(2) / 6 + 1e-9
    acceleration = path(s, 2)
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.05


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-0.03, 0.03), min_size=6, max_size=6).map(np.array))
def test_anchored_trajectory_starts_where_the_arm_is(offset: np.ndarray) -> None:
    end = np.array([0.8, -0.6, 0.5, 0.2, -0.4, 0.9])
    trajectory = time_path(SmoothPath.line(np.zeros(6), end), 0.6, FINE)
    moved = anchored(trajectory, offset)
    np.testing.assert_allclose(moved.positions[0], offset, atol=1e-12)
    np.testing.assert_allclose(moved.end, end, atol=1e-12)
    assert np.abs(moved.velocities[[0, -1]]).max() < 1e-12
    numeric = np.gradient(moved.positions, moved.times, axis=0)
    np.testing.assert_allclose(numeric[2:-2], moved.velocities[2:-2], atol=2e-4)
    assert (np.abs(moved.accelerations) <= ARM_ACCELERATION * 1.25).all()

import numpy as np
import pytest

from dgs_description.joints import JointPath
from dgs_sim_bridge.world.trajectory import (
    ArmState,
    FollowCode,
    SetPoint,
    Spline,
    TrajectoryRefused,
    braking_spline,
    spline_from,
)

STILL = ArmState(np.zeros(6), np.zeros(6), np.zeros(6))
RAMP = np.linspace(0, 1, 5)[:, None] * np.ones(6)


@pytest.mark.parametrize("accelerations", [None, np.ones((3, 6))])
def test_positions_alone_are_joined_by_straight_lines(accelerations: np.ndarray | None) -> None:
    ends = np.array([np.zeros(6), np.ones(6), np.zeros(6)])
    spline = Spline(JointPath(np.array([0.0, 1.0, 3.0]), ends, None, accelerations))
    np.testing.assert_allclose(spline.sample(0.25).positions, 0.25)
    np.testing.assert_allclose(spline.sample(0.25).velocities, 1.0)
    np.testing.assert_allclose(spline.sample(2.0).positions, 0.5)
    np.testing.assert_allclose(spline.sample(2.0).velocities, -0.5)


def test_velocities_make_a_cubic_and_accelerations_a_quintic() -> None:
    """Polynomials of these degrees are reproduced exactly."""
    times = np.array([0.0, 0.7, 1.5])
    for power, given in ((3, 2), (5, 3)):
        columns = [times**power, power * times ** (power - 1), power * (power - 1) * times ** (power - 2)]
        values = [np.repeat(column[:, None], 6, 1) for column in columns]
        values = [*values[:given], *[None] * (3 - given)]
        spline = Spline(JointPath(times, *values))  # type: ignore[arg-type]
        for t in (0.1, 0.69, 0.71, 1.2):
            point = spline.sample(t)
            np.testing.assert_allclose(point.positions, t**power, rtol=1e-9)
            np.testing.assert_allclose(point.velocities, power * t ** (power - 1), rtol=1e-9)


def test_before_the_start_and_after_the_end_the_arm_stands() -> None:
    spline = Spline(JointPath(np.array([0.0, 1.0]), np.array([np.zeros(6), np.ones(6)])))
    np.testing.assert_allclose(spline.sample(-1.0).positions, 0)
    np.testing.assert_allclose(spline.sample(1.5).positions, 1)
    for t in (-1.0, 1.0, 1.5):
        np.testing.assert_array_equal(spline.sample(t).velocities, 0)


def test_later_first_point_is_approached_from_where_the_arm_is() -> None:
    state = ArmState(np.full(6, 0.3), np.zeros(6), np.zeros(6))
    spline = spline_from(state, JointPath(np.array([2.0]), np.ones((1, 6))))
    np.testing.assert_allclose(spline.sample(0.0).positions, 0.3)
    np.testing.assert_allclose(spline.sample(1.0).positions, 0.65)
    assert spline.duration == 2.0


def test_velocity_of_the_moving_arm_is_taken_over() -> None:
    state = ArmState(np.zeros(6), np.full(6, 0.4), np.zeros(6))
    spline = spline_from(state, JointPath(np.array([1.0, 2.0]), np.ones((2, 6)), np.zeros((2, 6))))
    np.testing.assert_allclose(spline.sample(1e-6).velocities, 0.4, atol=1e-4)
    faster = JointPath(np.array([1.0, 2.0]), np.ones((2, 6)), np.zeros((2, 6)), np.full((2, 6), 3.0))
    np.testing.assert_allclose(spline_from(state, faster).sample(0.01).velocities, 0.4, atol=0.01)


def test_points_less_than_a_millisecond_apart_are_passed_one_after_the_other() -> None:
    for times in ([1e-4, 5e-4, 1.0], [5e-4, 1e-3, 1.0], [1e-12, 2e-12, 1.0]):
        spline = spline_from(STILL, JointPath(np.array(times), np.array([[0.1], [0.2], [0.3]]) * np.ones(6)))
        np.testing.assert_allclose(spline.sample(times[1]).positions, 0.2)
        assert np.isfinite(spline.sample(times[1] / 3).velocities).all()


def test_start_too_far_away_is_refused_with_the_joints_name() -> None:
    positions = np.zeros((2, 6))
    positions[0, 2] = 0.25
    with pytest.raises(TrajectoryRefused, match="0.250 rad away from .* elbow_joint.* 0.2 rad are") as caught:
        spline_from(STILL, JointPath(np.array([0.0, 1.0]), positions))
    assert caught.value.code == FollowCode.PATH_TOLERANCE_VIOLATED
    positions[0, 2] = 0.19
    spline_from(STILL, JointPath(np.array([0.0, 1.0]), positions))


def test_first_point_that_cannot_be_reached_in_time_is_refused() -> None:
    with pytest.raises(TrajectoryRefused, match=r"1\.000 rad away .* at 0\.10 s; 0\.514 rad are allowed"):
        spline_from(STILL, JointPath(np.array([0.1]), np.ones((1, 6))))
    nearer = np.array([[0.85, 0.0, 0.0, 0.0, 0.0, 0.9]])  # the wrist is faster
    with pytest.raises(TrajectoryRefused, match="shoulder_pan_joint"):
        spline_from(STILL, JointPath(np.array([0.2]), nearer))
    spline_from(STILL, JointPath(np.array([0.2]), nearer * (0.9, 1.0, 1.0, 1.0, 1.0, 1.0)))


def test_braking_starts_as_it_was_and_ends_at_rest_without_overshoot() -> None:
    now = SetPoint(np.zeros(6), np.array([1.0, -0.5, 0, 0, 0, 0.2]))
    spline = braking_spline(now)
    assert spline.duration == pytest.approx(0.2)
    np.testing.assert_allclose(spline.sample(1e-9).velocities, now.velocities, atol=1e-6)
    np.testing.assert_allclose(spline.sample(spline.duration - 1e-9).velocities, 0, atol=1e-6)
    path = np.array([spline.sample(t).positions[0] for t in np.linspace(0, spline.duration, 50)])
    assert (np.diff(path) >= 0).all() and path[-1] == pytest.approx(0.1)

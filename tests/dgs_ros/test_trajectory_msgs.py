"""JointTrajectory <-> numpy by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from hypothesis import given
from hypothesis import strategies as st
from trajectory_msgs.msg import JointTrajectory

from dgs_description.errors import DgsError, ErrorCode, JointNameError
from dgs_description.joints import JointPath
from dgs_ros.trajectory_msgs import path_to_trajectory, seconds, to_duration, trajectory_to_path
from tests.support.refused import refused

PATH = JointPath(
    times=np.array([0.0, 0.5, 2.25]),
    positions=np.array([[0.0, 10.0], [1.0, 11.0], [2.0, 12.0]]),
    velocities=np.array([[0.0, 0.1], [0.2, 0.3], [0.4, 0.5]]),
)


def test_there_and_back_in_another_order() -> None:
    found = trajectory_to_path(path_to_trajectory(("a", "b"), PATH), ("b", "a"))
    np.testing.assert_allclose(found.times, PATH.times)
    np.testing.assert_array_equal(found.positions, PATH.positions[:, ::-1])
    np.testing.assert_array_equal(found.velocities, PATH.velocities[:, ::-1])
    assert found.accelerations is None


@given(st.floats(0, 1e6))
def test_durations(value: float) -> None:
    duration = to_duration(value)
    assert 0 <= duration.nanosec < 1_000_000_000
    assert seconds(duration) == pytest.approx(value, abs=1e-9)


def test_a_duration_just_below_a_second_carries_over() -> None:
    assert to_duration(1.9999999999) == Duration(sec=2, nanosec=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(times=np.array([0.0, 0.5, 0.5])), "do not increase"),
        (dict(times=np.array([-1.0, 0.5, 0.6])), "do not increase"),
        (dict(times=np.array([0.0, 0.5])), "positions have shape"),
        (dict(times=np.array([]), positions=np.empty((0, 2)), velocities=None), "no points"),
        (dict(positions=np.full((3, 2), np.nan)), "positions are not all finite"),
        (dict(velocities=np.zeros((3, 3))), "velocities have shape"),
        (dict(accelerations=np.full((3, 2), np.inf)), "accelerations are not all finite"),
    ],
)
def test_bad_paths_are_not_sent(change: dict[str, np.ndarray], words: str) -> None:
    with refused(ErrorCode.TRAJECTORY_REJECTED, words):
        path_to_trajectory(("a", "b"), PATH._replace(**change))


def _point(index: int, **values: object) -> Callable[[JointTrajectory], None]:
    def change(msg: JointTrajectory) -> None:
        for key, value in values.items():
            setattr(msg.points[index], key, value)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda msg: msg.points.clear(), "no points"),
        (lambda msg: [setattr(point, "positions", []) for point in msg.points], "no positions"),
        (_point(1, positions=[1.0]), r"\[1, 2\] positions for 2 joints"),
        (_point(1, velocities=[]), r"\[0, 2\] velocities"),
        (_point(1, positions=[float("nan"), 0.0]), "not all finite"),
        (_point(2, time_from_start=Duration(sec=0, nanosec=5)), "do not increase"),
    ],
)
def test_bad_messages_are_refused(change: Callable[[JointTrajectory], None], words: str) -> None:
    msg = path_to_trajectory(("a", "b"), PATH)
    change(msg)
    with refused(ErrorCode.TRAJECTORY_REJECTED, words):
        trajectory_to_path(msg, ("a", "b"))


def test_joint_names_must_be_exactly_the_wanted_ones() -> None:
    msg = path_to_trajectory(("a", "b"), PATH)
    with pytest.raises(JointNameError, match="missing joints: c"):
        trajectory_to_path(msg, ("a", "c"))
    with pytest.raises(DgsError, match="joints that are not there: b"):
        trajectory_to_path(msg, ("a",))

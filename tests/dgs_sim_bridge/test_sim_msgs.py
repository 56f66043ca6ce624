import numpy as np
import pytest
from builtin_interfaces.msg import Time
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from trajectory_msgs.msg import MultiDOFJointTrajectoryPoint

from dgs_description.frames import transform
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_ros.trajectory_msgs import path_to_trajectory, to_duration, to_time
from dgs_sim_bridge.sim_msgs import goal_from_message, to_feedback, to_result, to_sim_state
from dgs_sim_bridge.world.arm_controller import Outcome
from dgs_sim_bridge.world.trajectory import ArmState, FollowCode, SetPoint, Tolerances, TrajectoryRefused
from dgs_sim_bridge.world.world import ObjectState

PATH = JointPath(np.array([0.0, 2.0]), np.arange(12.0).reshape(2, 6))


def message(path: JointPath = PATH, names: tuple[str, ...] = ARM_JOINTS) -> FollowJointTrajectory.Goal:
    return FollowJointTrajectory.Goal(trajectory=path_to_trajectory(names, path))


def test_times_are_rounded_to_nanoseconds() -> None:
    assert to_time(12.25) == Time(sec=12, nanosec=250_000_000)
    assert to_time(2.9999999999) == Time(sec=3, nanosec=0)


def test_goal_is_mapped_by_name_and_has_the_defaults() -> None:
    goal = goal_from_message(message(names=ARM_JOINTS[::-1]), now=5.0)
    np.testing.assert_array_equal(goal.path.positions, PATH.positions[:, ::-1])
    assert goal.path.velocities is None and goal.start_time is None
    check_default(goal.tolerances)


def check_default(tolerances: Tolerances) -> None:
    """Those of the UR driver's configuration."""
    for name, value in {"path": 0.2, "goal": 0.1, "path_velocity": np.inf, "goal_velocity": 0.2}.items():
        np.testing.assert_array_equal(getattr(tolerances, name), np.full(6, value))
    assert tolerances.goal_time == np.inf  # `goal_time: 0.0` there


def test_tolerances_and_start_time_of_the_goal_are_taken() -> None:
    wanted = message()
    wanted.path_tolerance = [JointTolerance(name="elbow_joint", position=0.05, velocity=0.3)]
    wanted.goal_tolerance = [
        JointTolerance(name="wrist_1_joint", position=0.01, velocity=2.2),
        JointTolerance(name="elbow_joint", position=0.03),
    ]
    wanted.goal_time_tolerance = to_duration(1.5)
    wanted.trajectory.header.stamp = to_time(7.0)
    goal = goal_from_message(wanted, now=5.0)
    taken = goal.tolerances
    np.testing.assert_array_equal(taken.path, [0.2, 0.2, 0.05, 0.2, 0.2, 0.2])
    np.testing.assert_array_equal(taken.path_velocity, [np.inf, np.inf, 0.3, np.inf, np.inf, np.inf])
    np.testing.assert_array_equal(taken.goal, [0.1, 0.1, 0.03, 0.01, 0.1, 0.1])
    np.testing.assert_array_equal(taken.goal_velocity, [0.2, 0.2, 0.2, 2.2, 0.2, 0.2])
    assert (taken.goal_time, goal.start_time) == (1.5, 7.0)
    check_default(goal_from_message(message(), now=5.0).tolerances)  # of the next goal


def test_a_tolerance_of_minus_one_allows_everything() -> None:
    wanted = message()
    free = [JointTolerance(name=name, position=-1.0, velocity=-1.0) for name in ARM_JOINTS]
    wanted.path_tolerance, wanted.goal_tolerance = free, free
    wanted.goal_time_tolerance.sec = -1
    taken = goal_from_message(wanted, now=5.0).tolerances
    for values in (taken.path, taken.path_velocity, taken.goal, taken.goal_velocity, taken.goal_time):
        assert np.isinf(values).all()


WITHOUT_MEANING = {
    "goal time": lambda goal: setattr(goal.goal_time_tolerance, "sec", -123),
    "path position": lambda goal: goal.path_tolerance.append(tolerance(position=-123.0)),
    "path velocity": lambda goal: goal.path_tolerance.append(tolerance(velocity=-123.0)),
    "goal position": lambda goal: goal.goal_tolerance.append(tolerance(position=-123.0)),
    "goal velocity": lambda goal: goal.goal_tolerance.append(tolerance(velocity=-123.0)),
    "no number": lambda goal: goal.goal_tolerance.append(tolerance(position=np.nan)),
    "joint of the path": lambda goal: goal.path_tolerance.append(tolerance("joint123", position=0.3)),
    "joint of the goal": lambda goal: goal.goal_tolerance.append(tolerance("joint123", position=0.3)),
}


def tolerance(name: str = "elbow_joint", **values: float) -> JointTolerance:
    return JointTolerance(name=name, **values)


@pytest.mark.parametrize("what", WITHOUT_MEANING)
def test_with_a_tolerance_without_meaning_the_default_ones_hold(what: str) -> None:
    wanted, told = message(), []
    wanted.path_tolerance = [tolerance("wrist_1_joint", position=0.01)]
    WITHOUT_MEANING[what](wanted)
    check_default(goal_from_message(wanted, 5.0, warn=told.append).tolerances)
    assert len(told) == 1 and "the default tolerances hold" in told[0]


def refused(code: FollowCode, match: str | None = None) -> pytest.RaisesExc[TrajectoryRefused]:
    return pytest.raises(TrajectoryRefused, match=match, check=lambda error: error.code == code)


def test_trajectory_of_the_past_is_refused() -> None:
    wanted = message()
    wanted.trajectory.header.stamp = to_time(7.0)
    goal_from_message(wanted, now=8.9)
    with refused(FollowCode.OLD_HEADER_TIMESTAMP):
        goal_from_message(wanted, now=9.1)


def test_bad_goals_are_refused_with_the_right_code() -> None:
    some = message(JointPath(PATH.times, PATH.positions[:, :5]), ARM_JOINTS[:5])
    wrong_name, multi = message(names=(*ARM_JOINTS[:5], "joint_6")), message()
    multi.multi_dof_trajectory.points = [MultiDOFJointTrajectoryPoint()]
    for wanted, code in (
        (wrong_name, FollowCode.INVALID_JOINTS),
        (some, FollowCode.INVALID_JOINTS),
        (FollowJointTrajectory.Goal(), FollowCode.INVALID_JOINTS),
        (multi, FollowCode.INVALID_GOAL),
    ):
        with refused(code, "."):
            goal_from_message(wanted, now=0.0)


def _twice(points: list) -> None:
    points.append(points[-1])


MALFORMED = {
    "no points": lambda points: points.clear(),
    "no positions": lambda points: setattr(points[0], "positions", []),
    "too few positions": lambda points: setattr(points[0], "positions", [0.0] * 5),
    "too many positions": lambda points: setattr(points[0], "positions", [0.0] * 7),
    "too few velocities": lambda points: setattr(points[0], "velocities", [0.0] * 5),
    "too few accelerations": lambda points: setattr(points[0], "accelerations", [0.0] * 5),
    "torques": lambda points: setattr(points[0], "effort", [1.0] * 6),
    "a time twice": _twice,
}


@pytest.mark.parametrize("what", MALFORMED)
def test_malformed_points_are_refused(what: str) -> None:
    wanted = message()
    for point in wanted.trajectory.points:
        point.velocities, point.accelerations = [0.0] * 6, [0.0] * 6
    goal_from_message(wanted, now=0.0)
    points = list(wanted.trajectory.points)
    MALFORMED[what](points)
    wanted.trajectory.points = points
    with refused(FollowCode.INVALID_GOAL):
        goal_from_message(wanted, now=0.0)


def test_a_trajectory_that_ends_in_motion_is_refused() -> None:
    moving = message()
    moving.trajectory.points[0].velocities = [0.1] * 6
    moving.trajectory.points[-1].velocities = [0.0] * 5 + [1e-3]
    with refused(FollowCode.INVALID_GOAL, "ends in motion"):
        goal_from_message(moving, now=0.0)
    moving.trajectory.points[-1].velocities = [0.0] * 6
    assert goal_from_message(moving, now=0.0).path.velocities is not None


def test_result_carries_code_and_sentence() -> None:
    result = to_result(Outcome("aborted", FollowCode.PATH_TOLERANCE_VIOLATED, "elbow left the path"))
    assert result.error_code == FollowJointTrajectory.Result.PATH_TOLERANCE_VIOLATED
    assert result.error_string == "elbow left the path"


def test_codes_are_those_of_control_msgs() -> None:
    for code in FollowCode:
        assert getattr(FollowJointTrajectory.Result, code.name) == code


def test_feedback_is_wanted_minus_measured() -> None:
    wanted = SetPoint(np.full(6, 0.5), np.full(6, 0.1), time=0.5)
    feedback = to_feedback(wanted, ArmState(np.full(6, 0.4), np.zeros(6), np.zeros(6)), 2.0, 3.0)
    assert list(feedback.joint_names) == list(ARM_JOINTS)
    np.testing.assert_allclose(feedback.error.positions, 0.1)
    np.testing.assert_allclose(feedback.error.velocities, 0.1)
    # The speed slider at 25 %: half a second of the trajectory takes two.
    assert (feedback.desired.time_from_start, feedback.actual.time_from_start) == (
        to_duration(0.5),
        to_duration(2.0),
    )
    assert feedback.header.stamp == to_time(3.0)


def test_ground_truth_message() -> None:
    state = to_sim_state([ObjectState("cup", transform(position=(0.1, 0.2, 0.3)), "bin")], 4.5)
    assert (list(state.names), list(state.places)) == (["cup"], ["bin"])
    assert state.header.frame_id == "base_link" and state.header.stamp == to_time(4.5)
    assert (state.poses[0].position.z, state.poses[0].orientation.w) == (0.3, 1.0)

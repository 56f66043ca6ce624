"""The simulator as a process of its own, seen through the hardware's interfaces only."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from control_msgs.msg import JointTolerance
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64
from ur_dashboard_msgs.msg import SafetyMode
from ur_msgs.srv import SetPayload

from dgs_description.errors import ErrorCode
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_perception.stereo import SemiGlobalMatcher, stereo_depth
from dgs_ros.image_msgs import (
    camera_info_to_baseline,
    camera_info_to_pinhole,
    depth_to_metres,
    depth_to_numpy,
    infrared_to_numpy,
)
from dgs_ros.trajectory_msgs import path_to_trajectory, seconds, to_duration
from dgs_sim_bridge.render.d455 import D455
from tests.support.environment import GUARD, free_port, reserved_domain_id, wait_until
from tests.support.processes import suite_node
from tests.support.ros_client import RosClient
from tests.support.sim_bench import Bench, move

pytestmark = pytest.mark.integration

DEPTH = "/camera/camera/depth/image_rect_raw"
Result = FollowJointTrajectory.Result


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    port = free_port()
    parameters = {"hand_port": port, "objects": 2, "seed": 3, "real_time_factor": 2.0}
    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id) as client,
        suite_node("sim_bridge_node", domain_id, tmp_path_factory.mktemp("logs"), parameters) as node,
    ):
        bench = Bench(node, client, port)
        node.wait_ready(lambda: bench.action.server_is_ready())
        yield bench


@pytest.fixture(autouse=True)
def clear(request: pytest.FixtureRequest) -> Iterator[None]:
    """No fault of one test reaches the next one."""
    yield
    bench = request.getfixturevalue("bench") if "bench" in request.fixturenames else None
    if bench is not None and bench.node.exit_code is None:
        bench.fault("clear")


def test_joint_states_clock_and_status(bench: Bench) -> None:
    states = bench.client.collect(JointState, "/joint_states", 60)
    stamps = np.array([seconds(m.header.stamp) for m in states])
    # The median: a client that gets no processor time for a while loses some.
    assert np.median(np.diff(stamps)) == pytest.approx(1 / 125, rel=0.05)
    assert (np.diff(stamps) > 0).all()
    assert set(states[0].name) == set(ARM_JOINTS) and list(states[0].name) != list(ARM_JOINTS)
    assert len(states[0].velocity) == len(states[0].effort) == 6
    clock = bench.client.collect(Clock, "/clock", 20)
    assert seconds(clock[-1].clock) > seconds(clock[0].clock) >= stamps[-1]
    assert bench.status() == (True, SafetyMode.NORMAL, 100.0)


def test_picture_is_what_realsense_would_publish(bench: Bench) -> None:
    infos: list[CameraInfo] = []
    subscription = bench.client.node.create_subscription(
        CameraInfo, "/camera/camera/depth/camera_info", infos.append, 10
    )
    images = bench.client.collect(Image, DEPTH, 2)
    bench.client.node.destroy_subscription(subscription)
    assert images[0].encoding == "16UC1" and images[0].header.frame_id == "camera_depth_optical_frame"
    depth = depth_to_numpy(images[0])
    assert depth.shape == (480, 848) and 0.7 < (depth > 0).mean() < 0.99
    assert 900 < np.median(depth[depth > 0]) < 1500
    assert camera_info_to_pinhole(infos[0]) == D455
    period = seconds(images[1].header.stamp) - seconds(images[0].header.stamp)
    pictures = max(round(period / 0.5), 1)  # a busy machine may miss one
    assert period == pytest.approx(0.5 * pictures, abs=0.02)
    (colour,) = bench.client.collect(Image, "/camera/camera/color/image_raw", 1)
    assert colour.encoding == "rgb8" and (colour.height, colour.width) == (480, 848)


def test_infrared_pairs_of_one_moment_agree_with_the_depth(bench: Bench) -> None:
    came: dict[str, dict[int, Any]] = {}
    topics = {
        "depth": (Image, DEPTH),
        "left": (Image, "/camera/camera/infra1/image_rect_raw"),
        "right": (Image, "/camera/camera/infra2/image_rect_raw"),
        "info": (CameraInfo, "/camera/camera/infra2/camera_info"),
    }
    subscriptions = []
    for name, (kind, topic) in topics.items():
        stamped = came.setdefault(name, {})

        def take(message: Any, stamped: dict[int, Any] = stamped) -> None:
            stamped[message.header.stamp.sec * 10**9 + message.header.stamp.nanosec] = message

        subscriptions.append(bench.client.node.create_subscription(kind, topic, take, 10))
    together: set[int] = set()
    bench.node.wait_ready(
        lambda: together.update(set.intersection(*map(set, came.values()))) or bool(together)
    )
    for subscription in subscriptions:
        bench.client.node.destroy_subscription(subscription)
    moment = {name: stamped[min(together)] for name, stamped in came.items()}
    baseline = camera_info_to_baseline(moment["info"])
    assert baseline == pytest.approx(0.095)
    left, right = infrared_to_numpy(moment["left"]), infrared_to_numpy(moment["right"])
    found = stereo_depth(SemiGlobalMatcher(D455, baseline), left, right, D455, baseline)
    reported = depth_to_metres(moment["depth"])
    both = (found > 0) & (reported > 0) & (reported < 1.3)
    assert both.mean() > 0.2
    assert np.median(np.abs(found - reported)[both]) < 0.01


def test_trajectory_is_followed_with_feedback(bench: Bench) -> None:
    start, seen = bench.joints(), []
    wrapped = bench.run(move(start, 0.2), lambda m: seen.append(m.feedback))
    assert wrapped.status == GoalStatus.STATUS_SUCCEEDED
    assert wrapped.result.error_code == Result.SUCCESSFUL and wrapped.result.error_string
    np.testing.assert_allclose(bench.joints(), start + 0.2, atol=5e-3)
    wait_until(lambda: len(seen) >= 5)  # the last may be heard behind the result
    assert max(abs(e) for e in seen[3].error.positions) < 0.02


def test_joint_names_in_any_order(bench: Bench) -> None:
    start = bench.joints()
    order = [3, 1, 5, 0, 2, 4]
    target = start + np.array([0.1, 0.0, 0.0, 0.0, 0.0, -0.3])
    path = JointPath(np.array([0.8]), target[None, order])
    goal = FollowJointTrajectory.Goal(trajectory=path_to_trajectory([ARM_JOINTS[k] for k in order], path))
    assert bench.run(goal).status == GoalStatus.STATUS_SUCCEEDED
    np.testing.assert_allclose(bench.joints(), target, atol=5e-3)


def test_malformed_goals_are_refused(bench: Bench) -> None:
    start = bench.joints()
    wrong_names = move(start, 0.1, names=[*ARM_JOINTS[:5], "wrist_4_joint"])
    not_finite = move(start, 0.1)
    not_finite.trajectory.points[1].positions[2] = math.nan
    backwards = move(start, 0.1)
    backwards.trajectory.points[1].time_from_start = to_duration(0.0)
    old = move(start, 0.1)
    old.trajectory.header.stamp.nanosec = 1
    for goal in (FollowJointTrajectory.Goal(), wrong_names, not_finite, backwards, old):
        assert not bench.send(goal).accepted
    np.testing.assert_allclose(bench.joints(), start, atol=1e-3)
    assert bench.run(move(bench.joints(), 0.05)).status == GoalStatus.STATUS_SUCCEEDED


def test_a_joint_that_is_not_there_in_the_tolerances_does_not_matter(bench: Bench) -> None:
    goal = move(bench.joints(), 0.05)
    goal.goal_tolerance = [JointTolerance(name="nose", position=0.1)]
    assert bench.run(goal).status == GoalStatus.STATUS_SUCCEEDED
    assert "the default tolerances hold" in bench.node.log()


def test_a_fast_step_between_two_points_is_followed(bench: Bench) -> None:
    start = bench.joints()
    path = JointPath(np.array([0.5, 0.7]), np.stack([start, start - 0.4]))
    goal = FollowJointTrajectory.Goal(trajectory=path_to_trajectory(ARM_JOINTS, path))
    assert bench.run(goal).status == GoalStatus.STATUS_SUCCEEDED
    bench.client.collect(
        JointState, "/joint_states", 40
    )  # at the end of the goal it may be the goal's tolerance off
    np.testing.assert_allclose(bench.joints(), start - 0.4, atol=5e-3)


def test_a_step_that_no_arm_can_follow_aborts_and_the_arm_stands(bench: Bench) -> None:
    start = bench.joints()
    path = JointPath(np.array([0.5, 0.51, 2.5]), np.stack([start, start + 1.0, start + 1.5]))
    goal = FollowJointTrajectory.Goal(trajectory=path_to_trajectory(ARM_JOINTS, path))
    ended = bench.run(goal)
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_code == Result.PATH_TOLERANCE_VIOLATED
    bench.client.collect(JointState, "/joint_states", 40)
    here = bench.joints()
    assert np.abs(here - start).max() < 0.5
    bench.client.collect(JointState, "/joint_states", 60)
    np.testing.assert_allclose(bench.joints(), here, atol=2e-3)


def test_a_tolerance_that_no_arm_can_keep_ends_the_goal(bench: Bench) -> None:
    goal = move(bench.joints(), 0.05)
    goal.goal_tolerance = [JointTolerance(name=name, position=1e-9) for name in ARM_JOINTS]
    goal.goal_time_tolerance = to_duration(0.5)
    ended = bench.run(goal)
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert ended.result.error_code == Result.GOAL_TOLERANCE_VIOLATED


def test_start_away_from_the_measured_state_is_not_run(bench: Bench) -> None:
    start = bench.joints()
    wrapped = bench.run(move(start + 0.3, 0.1))
    assert wrapped.status == GoalStatus.STATUS_ABORTED
    assert wrapped.result.error_code == Result.PATH_TOLERANCE_VIOLATED
    assert "away from the measured" in wrapped.result.error_string
    np.testing.assert_allclose(bench.joints(), start, atol=1e-3)


def test_cancel_holds_the_arm(bench: Bench) -> None:
    start, begun = bench.joints(), threading.Event()
    handle = bench.send(move(start, 0.5, 20.0), lambda _: begun.set())
    assert begun.wait(GUARD)
    bench.client.wait(handle.cancel_goal_async())
    assert bench.end(handle).status == GoalStatus.STATUS_CANCELED
    bench.client.collect(JointState, "/joint_states", 40)  # lets it brake
    here = bench.joints()
    assert (here < start + 0.45).all()
    bench.client.collect(JointState, "/joint_states", 60)
    np.testing.assert_allclose(bench.joints(), here, atol=2e-3)


def test_new_goal_preempts_the_running_one(bench: Bench) -> None:
    start, begun = bench.joints(), threading.Event()
    first = bench.send(move(start, 0.3, 20.0), lambda _: begun.set())
    assert begun.wait(GUARD)
    here = bench.joints()
    goal = FollowJointTrajectory.Goal(
        trajectory=path_to_trajectory(ARM_JOINTS, JointPath(np.array([1.0]), here[None]))
    )
    second = bench.run(goal)
    assert second.status == GoalStatus.STATUS_SUCCEEDED
    ended = bench.end(first)
    assert ended.status == GoalStatus.STATUS_ABORTED and ended.result.error_code == Result.INVALID_GOAL


def test_protective_stop_pauses_the_trajectory_which_goes_on_unless_cancelled(bench: Bench) -> None:
    begun = threading.Event()
    handle = bench.send(move(bench.joints(), 0.2, 6.0), lambda _: begun.set())
    assert begun.wait(GUARD)
    assert bench.fault("protective_stop").error_code == 0
    bench.client.collect(Float64, "/speed_scaling_state_broadcaster/speed_scaling", 4)
    assert bench.status() == (True, SafetyMode.PROTECTIVE_STOP, 0.0)
    held = bench.joints()
    bench.client.collect(Float64, "/speed_scaling_state_broadcaster/speed_scaling", 4)
    assert np.abs(bench.joints() - held).max() < 2e-3
    assert handle.status == GoalStatus.STATUS_EXECUTING, "it is over: nothing was paused"
    bench.fault("clear")
    assert bench.end(handle).status == GoalStatus.STATUS_SUCCEEDED


def test_emergency_stop_ends_the_program(bench: Bench) -> None:
    begun = threading.Event()
    handle = bench.send(move(bench.joints(), -0.3, 20.0), lambda _: begun.set())
    assert begun.wait(GUARD)
    assert bench.fault("emergency_stop").error_code == 0
    ended = bench.end(handle)
    assert ended.status == GoalStatus.STATUS_ABORTED and "program" in ended.result.error_string
    assert bench.status() == (False, SafetyMode.ROBOT_EMERGENCY_STOP, 0.0)
    assert not bench.send(move(bench.joints(), 0.1)).accepted
    bench.fault("clear")
    bench.client.collect(Float64, "/speed_scaling_state_broadcaster/speed_scaling", 2)
    assert bench.run(move(bench.joints(), 0.05)).status == GoalStatus.STATUS_SUCCEEDED


@pytest.mark.parametrize(("mass", "taken"), [(1.7, True), (3.5, False), (-0.1, False)])
def test_set_payload_takes_what_the_arm_may_carry(bench: Bench, mass: float, taken: bool) -> None:
    request = SetPayload.Request(mass=mass)
    answer = bench.client.call(SetPayload, "/io_and_status_controller/set_payload", request)
    assert answer.success == taken


def test_abort_arm_goal(bench: Bench) -> None:
    assert bench.fault("abort_arm_goal").error_code == 0
    ended = bench.run(move(bench.joints(), 0.2, 2.0))
    assert ended.status == GoalStatus.STATUS_ABORTED and "abort_arm_goal" in ended.result.error_string


def test_silent_joint_states_and_frozen_camera_come_back(bench: Bench) -> None:
    before = seconds(bench.client.collect(Clock, "/clock", 3)[-1].clock)
    assert bench.fault("drop_joint_states", duration=3.0).error_code == 0
    assert bench.fault("freeze_camera", duration=3.0).error_code == 0
    (state,) = bench.client.collect(JointState, "/joint_states", 1)
    (image,) = bench.client.collect(Image, DEPTH, 1)
    assert seconds(state.header.stamp) > before + 2.0
    assert seconds(image.header.stamp) > before + 2.0


@pytest.mark.parametrize(
    ("fault", "target", "code"),
    [("gremlins", "", ErrorCode.SIM_FAULT_UNKNOWN), ("jam_finger", "nose", ErrorCode.SIM_REQUEST)],
)
def test_bad_faults_are_refused(bench: Bench, fault: str, target: str, code: ErrorCode) -> None:
    reply = bench.fault(fault, target)
    assert reply.error_code == code and 0 < len(reply.message) < 2000


def test_reset_gives_the_seeds_scene(bench: Bench) -> None:
    replies, poses = [], []
    for _ in range(2):
        replies.append(bench.reset(seed=5, objects=3, catalogue="novel"))
        state = bench.state()
        assert list(state.names) == list(replies[-1].object_names)
        poses.append([(p.position.x, p.position.y, p.position.z) for p in state.poses])
        assert state.header.frame_id == "base_link" and set(state.places) == {"table"}
    assert replies[0].error_code == 0 and len(replies[0].object_names) == 3
    assert replies[0].object_names == replies[1].object_names
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-4)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ({"objects": 99}, ErrorCode.SIM_REQUEST),
        ({"objects": 2, "catalogue": "/no/such/file"}, ErrorCode.SIM_CATALOGUE),
        ({"objects": 2, "catalogue": "/etc/passwd"}, ErrorCode.SIM_CATALOGUE),
        ({"objects": 2, "catalogue": "~nobody_of_this_name/x"}, ErrorCode.SIM_CATALOGUE),
        ({"objects": 2, "catalogue": 100_000 * "x"}, ErrorCode.SIM_CATALOGUE),
    ],
)
def test_bad_resets_are_refused_and_leave_the_scene(bench: Bench, request_: dict, code: ErrorCode) -> None:
    before = bench.state().names
    reply = bench.reset(seed=1, **request_)
    assert reply.error_code == code and 0 < len(reply.message) < 2000
    assert bench.state().names == before


def test_second_simulator_on_the_same_port_refuses_to_start(bench: Bench, tmp_path: Path) -> None:
    parameters, left = {"hand_port": bench.port, "objects": 2}, tmp_path / "left"
    left.mkdir()
    with (
        reserved_domain_id() as domain_id,
        suite_node(
            "sim_bridge_node", domain_id, tmp_path, parameters, environment={"TMPDIR": str(left)}
        ) as node,
    ):
        assert node.wait() == 2
        assert str(bench.port) in node.log() and "cannot start" in node.log() and "hand_port:=" in node.log()
        assert not list(left.glob("dgs_parts_*"))


def test_interrupt_in_the_middle_of_a_motion(bench: Bench) -> None:
    """Last of the module: it ends the node."""
    begun = threading.Event()
    bench.send(move(bench.joints(), 0.3, 20.0), lambda _: begun.set())
    assert begun.wait(GUARD)
    bench.client.collect(Image, DEPTH, 1)
    assert bench.node.interrupt() == 0

"""What the page's node makes of topics."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from dgs_interfaces.action import ClearTable, ExecuteGrasp
from dgs_interfaces.srv import SimReset
from rclpy.executors import Executor, ExternalShutdownException, ShutdownException
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_srvs.srv import Trigger

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_ros.base_node import LATCHED
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.image_msgs import numpy_to_image, pinhole_to_camera_info
from dgs_viewer.page import Page
from dgs_viewer.state import Offer
from dgs_viewer.viewer_node import ViewerNode
from tests.support.environment import wait_until
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


def spin(executor: Executor) -> None:
    with suppress(ExternalShutdownException, ShutdownException):
        executor.spin()


@pytest.fixture
def viewer(ros_client: RosClient) -> Iterator[ViewerNode]:
    node = ViewerNode(context=ros_client.node.context, parameter_overrides=[Parameter("port", value=0)])
    executors = node.make_executors()
    threads = [threading.Thread(target=spin, args=(executor,)) for executor in executors]
    for thread in threads:
        thread.start()
    yield node
    node.stopping.set()
    for executor, thread in zip(executors, threads, strict=True):
        executor.shutdown()
        thread.join()
    node.close()
    node.destroy_node()


def test_a_picture_that_the_camera_info_is_not_of_colours_nothing(viewer: ViewerNode) -> None:
    picture = numpy_to_image(np.zeros((6, 8, 3), np.uint8), "eye")
    for width, frame, used in ((8, "eye", True), (16, "eye", False), (8, "eye", True), (8, "depth", False)):
        viewer._read_camera(pinhole_to_camera_info(PinholeCamera.centred(width, 6, 5.0), frame))
        viewer._guarded("picture", viewer._read_picture)(picture)
        assert (viewer._picture is not None) == used
    of_depth, wider = viewer._state.recent(2)
    assert "8 x 6 pixels in 'eye', the camera info 16 x 6" in wider.text
    assert "8 x 6 pixels in 'eye', the camera info 8 x 6 pixels in 'depth'" in of_depth.text


def test_a_button_that_does_nothing_says_so_in_the_head_of_the_panel(
    ros_client: RosClient, viewer: ViewerNode
) -> None:
    viewer.stop()
    assert viewer._state.now.sentence == "stop: nobody serves /stop"
    viewer.clear(1, None)
    assert viewer._state.now.sentence.startswith("nobody serves /clear_table")

    def refuse(_: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.message = "the robot is in a protective stop"
        return answer

    ros_client.node.create_service(Trigger, "/reset", refuse)
    wait_until(viewer._reset.service_is_ready)
    viewer.reset()
    wait_until(lambda: viewer._state.now.sentence == "reset: the robot is in a protective stop")


def test_another_scene_is_shown_without_the_hands_of_the_one_before(
    ros_client: RosClient, viewer: ViewerNode
) -> None:
    given = iter((int(ErrorCode.SIM_SCENE), 0))

    def reset(_: SimReset.Request, answer: SimReset.Response) -> SimReset.Response:
        answer.error_code, answer.message = next(given), "as asked"
        return answer

    ros_client.node.create_service(SimReset, "/sim/reset", reset)
    wait_until(viewer._sim.service_is_ready)
    viewer._state.put(offer=Offer(GraspSet.empty()))
    viewer.new_scene(1, 5)
    wait_until(lambda: [event.code for event in viewer._state.recent(1)] == [ErrorCode.SIM_SCENE])
    assert viewer._state.now.offer is not None
    viewer.new_scene(1, 5)
    wait_until(lambda: viewer._state.now.offer is None)


def test_what_stays_wrong_is_logged_once_whatever_else_is_said(viewer: ViewerNode) -> None:
    def take(topic: str, wrong: str) -> None:
        def read(_: object) -> None:
            if wrong:
                raise DgsError(ErrorCode.CLOUD_FORMAT, wrong)

        viewer._guarded(topic, read)(None)

    def logged() -> list[str]:
        return [event.text for event in viewer._state.recent(20) if event.text[0] in "ab"][::-1]

    for _ in range(3):
        take("a", "no fields")
        take("b", "too long")
    assert logged() == ["a: no fields", "b: too long"]
    take("a", "")
    take("a", "no fields")
    assert logged() == ["a: no fields", "b: too long", "a: no fields"]


def test_who_looks_again_sees_no_colours_of_what_was_there_before(viewer: ViewerNode) -> None:
    viewer._watch(True)
    viewer._read_picture(numpy_to_image(np.zeros((6, 8, 3), np.uint8), "eye"))
    viewer._watch(False)
    assert viewer._picture is None


def test_clouds_go_on_when_the_clock_is_set_back(viewer: ViewerNode, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[float] = []
    monkeypatch.setattr(viewer, "_read_cloud", lambda _: read.append(time.monotonic()))
    monkeypatch.setattr(Page, "seen", True)
    set_back = time.time() - 3600.0
    monkeypatch.setattr(
        "dgs_viewer.viewer_node.time", SimpleNamespace(time=lambda: set_back, monotonic=time.monotonic)
    )
    cloud = serialize_message(numpy_to_cloud(np.zeros((1, 3)), "eye"))

    def comes() -> bool:
        viewer._newest["cloud"] = cloud
        return len(read) > 1

    wait_until(comes)


def test_the_page_is_idle_when_goals_have_ended_that_it_did_not_send(
    ros_client: RosClient, viewer: ViewerNode
) -> None:
    # Of an action, clients or none, these are the topics.
    create = ros_client.node.create_publisher
    actions: tuple[tuple[str, Any], ...] = (("/clear_table", ClearTable), ("/execute_grasp", ExecuteGrasp))
    feedback = {
        name: create(kind.Impl.FeedbackMessage, f"{name}/_action/feedback", 10) for name, kind in actions
    }
    status = {name: create(GoalStatusArray, f"{name}/_action/status", LATCHED) for name, _ in actions}
    kinds = dict(actions)

    def told(name: str, code: int, stage: str) -> bool:
        status[name].publish(GoalStatusArray(status_list=[GoalStatus(status=code)]))
        if code == GoalStatus.STATUS_EXECUTING:
            kind = kinds[name]
            feedback[name].publish(kind.Impl.FeedbackMessage(feedback=kind.Feedback(stage="carry")))
        return bool(viewer._state.now.stage == stage)

    for name in kinds:  # of /execute_grasp plan_pick sends such
        wait_until(partial(told, name, GoalStatus.STATUS_EXECUTING, "carry"))
        wait_until(partial(told, name, GoalStatus.STATUS_SUCCEEDED, "idle"))
    wait_until(lambda: told("/clear_table", GoalStatus.STATUS_EXECUTING, "carry"))
    wait_until(lambda: told("/execute_grasp", GoalStatus.STATUS_SUCCEEDED, "carry"))
    ros_client.node.destroy_publisher(status["/clear_table"])
    wait_until(lambda: viewer._state.now.stage == "idle")
    assert viewer._state.now.sentence == "who serves /clear_table has gone in the middle of it"


@pytest.mark.parametrize(
    ("code", "message", "pushes", "logged"),
    [
        (
            0,
            "the table is empty; 2 of 3 grasps succeeded",
            0,
            "run ended: the table is empty; 2 of 3 grasps succeeded",
        ),
        (
            ErrorCode.TASK_ATTEMPTS_USED_UP,
            "all 5 attempts are used up",
            2,
            "run ended: all 5 attempts are used up; 2 of 3 grasps succeeded, 2 pushes",
        ),
        (ErrorCode.TASK_BUSY, "another run is going on", 0, "another run is going on"),
    ],
)
def test_how_a_run_has_ended_is_said_once_and_with_its_pushes(
    viewer: ViewerNode, code: int, message: str, pushes: int, logged: str
) -> None:
    def at_once(result: object) -> SimpleNamespace:
        future = SimpleNamespace(result=lambda: result)
        future.add_done_callback = lambda callback: callback(future)
        return future

    result = ClearTable.Result(error_code=int(code), message=message, attempts=3, successes=2, pushes=pushes)
    ended = at_once(SimpleNamespace(status=GoalStatus.STATUS_SUCCEEDED, result=result))
    viewer._on_accepted(None, at_once(SimpleNamespace(accepted=True, get_result_async=lambda: ended)))
    assert viewer._state.recent(1)[0].text == logged
    assert viewer._state.now.sentence == ("no run yet" if code == ErrorCode.TASK_BUSY else logged[11:])

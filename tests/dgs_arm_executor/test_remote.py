import time
from types import SimpleNamespace

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_srvs.srv import Trigger

from dgs_arm_executor import remote
from dgs_description.errors import DgsError, ErrorCode
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_service_whose_answer_is_lost_is_asked_once_more(
    ros_client: RosClient, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    monkeypatch.setattr(remote, "_SERVICE_TIMEOUT", 0.5)
    questions: list[Trigger.Request] = []
    over: Future[None] = Future()

    async def serve(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        questions.append(request)
        if len(questions) <= lost:
            await over
        response.message = "here"
        return response

    node, group = ros_client.node, ReentrantCallbackGroup()
    server = node.create_service(Trigger, "/asked", serve, callback_group=group)
    client = node.create_client(Trigger, "/asked", callback_group=group)
    try:
        assert client.wait_for_service(5.0)
        if lost < 2:
            assert remote.call_service(client, Trigger.Request(), ErrorCode.PAYLOAD_REFUSED).message == "here"
        else:
            with pytest.raises(DgsError, match="/asked: no answer within 1 s") as error:
                remote.call_service(client, Trigger.Request(), ErrorCode.PAYLOAD_REFUSED)
            assert error.value.code == ErrorCode.PAYLOAD_REFUSED
    finally:
        over.set_result(None)
        node.destroy_client(client)
        node.destroy_service(server)
    assert len(questions) == min(lost + 1, 2)


def test_a_server_that_discovery_loses_for_a_moment_has_not_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "_GRACE", 0.2)
    here = True
    client = SimpleNamespace(server_is_ready=lambda: here)
    goal = remote.RemoteGoal(
        client, "/served", ErrorCode.TRAJECTORY_REJECTED, ErrorCode.CONTROLLER_UNAVAILABLE
    )
    goal.check()
    here = False
    goal.check()
    time.sleep(0.25)
    with pytest.raises(DgsError, match="/served has gone"):
        goal.check()
    here = True
    goal.check()


def test_a_server_that_does_not_answer_is_asked_again_to_end_what_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "_SERVICE_TIMEOUT", 0.1)
    answers = [Future(), Future()]
    client = SimpleNamespace(server_is_ready=lambda: True, cancel_all_async=iter(answers).__next__)
    goal = remote.RemoteGoal(
        client, "/served", ErrorCode.TRAJECTORY_REJECTED, ErrorCode.CONTROLLER_UNAVAILABLE
    )
    answers[1].set_result(None)
    assert not goal.available() and not goal.available()
    time.sleep(0.15)
    assert goal.available()

import time
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_srvs.srv import Trigger

from dgs_arm_executor import remote
from dgs_description.errors import DgsError, ErrorCode
from tests.support.refused import refused
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


def remote_goal(client: Any) -> remote.RemoteGoal:
    return remote.RemoteGoal(
        client, "/served", ErrorCode.TRAJECTORY_REJECTED, ErrorCode.CONTROLLER_UNAVAILABLE
    )


def test_a_server_that_discovery_loses_for_a_moment_has_not_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "_GRACE", 0.2)
    here, asked = True, list[Future]()

    def end_all() -> Future:
        asked.append(Future())
        asked[-1].set_result(None)
        return asked[-1]

    goal = remote_goal(SimpleNamespace(server_is_ready=lambda: here, cancel_all_async=end_all))
    assert goal.available()
    here = False
    goal.check()
    assert goal.available() and len(asked) == 1
    time.sleep(0.25)
    assert not goal.available()
    with refused(ErrorCode.CONTROLLER_UNAVAILABLE, "/served has gone"):
        goal.check()
    here = True
    goal.check()
    assert goal.available() and len(asked) == 2, "another one may have been left a goal"


def test_a_server_that_does_not_answer_is_asked_again_to_end_what_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "_SERVICE_TIMEOUT", 0.1)
    answers = [Future(), Future()]
    client = SimpleNamespace(server_is_ready=lambda: True, cancel_all_async=iter(answers).__next__)
    goal = remote_goal(client)
    answers[1].set_result(None)
    assert not goal.available() and not goal.available()
    time.sleep(0.15)
    assert goal.available()


class Server:
    """Answers a goal as the test says, seen through a client; `taken`: it accepts, `ended`: the goal is over."""

    def __init__(self, taken: bool = True, ended: bool = False) -> None:
        self.sent, self.result, self.gone = Future(), Future(), False
        self.goals, self.cancels = 0, list[str]()
        handle = SimpleNamespace(
            accepted=True,
            get_result_async=lambda: self.result,
            cancel_goal_async=lambda: self.cancels.append("now"),
        )
        if taken:
            self.sent.set_result(handle)
        if ended:
            self.result.set_result("result")

    def server_is_ready(self) -> bool:
        return True

    def watch_server(self) -> Any:
        return SimpleNamespace(lost=lambda: self.gone)

    def send_goal_async(self, goal: Any, feedback_callback: Any) -> Future:
        self.goals += 1
        return self.sent

    def cancel_when_accepted(self, sent: Future) -> None:
        self.cancels.append("when accepted")


def stops(after: int) -> Any:
    """A watch that raises when it has been asked so often."""
    asked = iter(range(10**6))

    def watch() -> None:
        if next(asked) >= after:
            raise DgsError(ErrorCode.STOPPED, "stopped")

    return watch


@pytest.mark.parametrize(
    ("server", "asked", "cancels"),
    [
        (Server(), 0, []),
        (Server(ended=True), 1, ["now"]),
        (Server(), 2, ["now", "when accepted"]),
        (Server(taken=False), 2, ["when accepted"]),
    ],
    ids=["before it is sent", "as it is accepted", "later, and it does not end", "before it is accepted"],
)
def test_a_stop_ends_a_goal_whenever_it_comes(
    server: Server, asked: int, cancels: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote, "_CANCEL_TIMEOUT", 0.1)
    with refused(ErrorCode.STOPPED):
        remote_goal(server).run(None, stops(asked))
    assert server.cancels == cancels and server.goals == (asked > 0)


def test_a_goal_that_nobody_answers_is_refused_and_must_not_start_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "_ANSWER_TIMEOUT", 0.1)
    server = Server(taken=False)
    with refused(ErrorCode.TRAJECTORY_REJECTED, "/served: no answer within 0.1 s"):
        remote_goal(server).run(None, lambda: None)
    assert server.cancels == ["when accepted"]


def test_a_server_that_goes_with_its_goal_is_not_waited_for() -> None:
    server = Server()
    server.gone = True
    with refused(ErrorCode.CONTROLLER_UNAVAILABLE, "/served went while it had a goal"):
        remote_goal(server).run(None, lambda: None)

"""Who is there: killed servers and clients are noticed, and told apart from those that take their place."""

from __future__ import annotations

import signal
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest
from dgs_interfaces.action import ClearTable
from rclpy.action.server import ServerGoalHandle
from std_srvs.srv import Trigger

from dgs_bringup.ros_session import wait_until
from dgs_ros.action_client import SafeActionClient
from dgs_ros.action_server import CountingActionServer
from dgs_ros.presence import GRACE, Watch, watch_client, watch_server
from tests.conftest import FASTDDS_PROFILE
from tests.dgs_ros.conftest import Node
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


def test_the_profile_promises_two_seconds() -> None:
    name = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"

    def seconds(tag: str) -> float:
        (found,) = ElementTree.parse(FASTDDS_PROFILE).iter(f"{name}{tag}")
        return int(found.findtext(f"{name}sec", "")) + 1e-9 * int(found.findtext(f"{name}nanosec", ""))

    assert 1.0 < seconds("leaseDuration") <= 2.0 - GRACE
    assert seconds("leaseAnnouncement") < GRACE


def test_who_is_known_only_later_may_go_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_ros.presence.GRACE", 0.2)
    there: set[bytes] = set()
    watch = Watch(lambda: there)
    assert not wait_until(watch.lost, 0.5), "of nobody"
    there = {b"a"}
    assert not wait_until(watch.lost, 0.5)
    there = set()
    assert wait_until(watch.lost, GUARD)


def test_who_comes_back_with_the_same_identity_has_not_gone() -> None:
    there, known = {b"a", b"b"}, {b"a", b"b"}
    watch = Watch(lambda: set(there))
    assert not watch.lost()
    for _ in range(2):  # an overloaded machine: missing, but for a short time
        there.discard(b"b")
        assert not wait_until(watch.lost, 0.6 * GRACE)
        there |= known
        assert not wait_until(watch.lost, 0.6 * GRACE)
    there.discard(b"b")
    there.add(b"c")  # another one in its place
    time.sleep(2 * GRACE)  # nobody has looked meanwhile
    assert not watch.lost()
    assert wait_until(watch.lost, GUARD)


def test_a_killed_server_is_missed_also_when_another_one_comes(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    first = start()
    service = ros_client.node.create_client(Trigger, "/work_node/break")
    action = SafeActionClient(ros_client.node, ClearTable, "/work_node/clear")
    assert wait_until(lambda: service.service_is_ready() and action.server_is_ready(), GUARD)
    watches = [watch_server(ros_client.node, "/work_node/break"), action.watch_server()]
    second = start()
    second.wait_for("ready")
    assert not any(watch.lost() for watch in watches)
    first.end(signal.SIGKILL)
    killed = time.monotonic()
    assert wait_until(lambda: all(watch.lost() for watch in watches), GUARD)
    assert time.monotonic() - killed < 10.0, "without the profile it takes 20 s"
    assert service.service_is_ready() and action.server_is_ready()
    assert not watch_server(ros_client.node, "/work_node/break").lost()


def test_a_session_asks_again_when_the_server_goes_before_it_answers(
    start: Callable[..., Node], ros_client: RosClient
) -> None:
    first = start()
    service = ros_client.node.create_client(Trigger, "/work_node/break")
    assert wait_until(service.service_is_ready, GUARD)
    first.process.send_signal(signal.SIGSTOP)
    with ThreadPoolExecutor() as pool:
        answer = pool.submit(ros_client.call, Trigger, "/work_node/break", Trigger.Request())
        first.process.kill()
        start().wait_for("ready")
        assert not answer.result(GUARD / 2).success


def test_the_client_of_a_goal_is_missed(ros_domain_id: int, ros_client: RosClient) -> None:
    goals: list[ServerGoalHandle] = []

    def execute(goal: ServerGoalHandle) -> ClearTable.Result:
        goals.append(goal)
        goal.succeed()
        return ClearTable.Result()

    server = CountingActionServer(ros_client.node, ClearTable, "/clear", execute)
    with RosClient(ros_domain_id, "caller") as caller, RosClient(ros_domain_id, "other") as other:
        for client in (caller, other):
            client.run_action(ClearTable, "/clear", ClearTable.Goal())

        def known() -> set[str]:
            feedback = ros_client.node.get_subscriptions_info_by_topic("/clear/_action/feedback")
            return {info.node_name for info in feedback}

        # Who was never seen cannot be missed, and discovery may come later than the goal.
        assert wait_until(lambda: {"caller", "other"} <= known(), GUARD)
        watches = [watch_client(ros_client.node, "/clear", goal.goal_id) for goal in goals]
        other.__exit__()
        assert wait_until(watches[1].lost, GUARD)
        assert not watches[0].lost()
        other.__enter__()
    assert server.unfinished == 0

"""The hand's node as a process of its own, on a real bus with a hand of simple joints: one test per error code."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from dgs_interfaces.action import MoveHand
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import LATCHED
from tests.dgs_hand_driver.simulated_hand import SimulatedHand
from tests.support.environment import GUARD, free_port, reserved_domain_id, run_as, wait_until
from tests.support.processes import NodeProcess, suite_node
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

SHAPE = np.tile([0.1, 0.8, 0.5, 0.5], 5)
NAN = float("nan")


class Bench:
    """A node process, a client of it, and the hand at the other end of the bus."""

    def __init__(self, simulated: SimulatedHand, node: NodeProcess, client: RosClient) -> None:
        self.simulated = simulated
        self.node = node
        self.client = client
        self.action = SafeActionClient(client.node, MoveHand, "/dexhand/move")

    def send(self, goal: MoveHand.Goal, feedback: Any = None) -> Any:
        """The handle of an accepted goal."""
        handle = self.client.wait(self.action.send_goal_async(goal, feedback_callback=feedback))
        assert handle.accepted
        return handle

    def end(self, handle: Any, timeout: float = GUARD) -> Any:
        """The result, and that its status and code belong together."""
        wrapped = self.client.wait(handle.get_result_async(), timeout)
        expected = {ErrorCode.SUCCESS: GoalStatus.STATUS_SUCCEEDED, ErrorCode.HAND_CANCELLED: wrapped.status}
        assert wrapped.status == expected.get(wrapped.result.error_code, GoalStatus.STATUS_ABORTED)
        assert wrapped.result.message and list(wrapped.result.joint_names) == list(HAND.joints)
        return wrapped.result

    def move(self, goal: MoveHand.Goal, feedback: Any = None) -> Any:
        """Send a goal and wait for its result."""
        return self.end(self.send(goal, feedback))

    def wait_connected(self) -> None:
        """Until joint states come."""
        self.client.collect(JointState, "/dexhand/joint_states")

    def moved(self) -> bool:
        return bool(np.abs(self.simulated.positions).max() > 0.02)


def goal(
    positions: Any = SHAPE,
    names: Any = HAND.joints,
    speed: float = 2.0,
    mode: int = MoveHand.Goal.MODE_POSITION,
    active: Sequence[bool] = (),
) -> MoveHand.Goal:
    return MoveHand.Goal(
        joint_names=list(names),
        positions=[float(p) for p in positions],
        speed=speed,
        mode=mode,
        active_fingers=list(active),
    )


def changed(joint: int, value: float) -> np.ndarray:
    positions = SHAPE.copy()
    positions[joint] = value
    return positions


@contextmanager
def connected(
    simulated: SimulatedHand, folder: Path, environment: dict[str, str] | None = None, **parameters: Any
) -> Iterator[Bench]:
    """A node with a simulated hand, which it knows; it must end well."""
    with (
        simulated,
        reserved_domain_id() as domain,
        RosClient(domain) as client,
        suite_node(
            "hand_driver_node",
            domain,
            folder,
            {"port": simulated.port, **parameters},
            environment=environment or {},
        ) as node,
    ):
        bench = Bench(simulated, node, client)
        node.wait_ready(bench.action.server_is_ready)
        bench.wait_connected()
        yield bench
        assert node.interrupt() == 0


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """One node for all tests that leave it alive."""
    folder = tmp_path_factory.mktemp("hand_driver")
    with connected(SimulatedHand(), folder, silence_timeout=2.0) as bench:  # tests of silence wait that long
        yield bench


@pytest.fixture
def bench(shared: Bench) -> Iterator[Bench]:
    """The shared bench with an open, healthy hand; the node must still work after the test."""
    yield shared
    simulated = shared.simulated
    simulated.walls, simulated.slowness, simulated.silent = {}, 1.0, False
    simulated.bus_end.inject("none")
    shared.wait_connected()
    wait_until(lambda: shared.move(goal(SHAPE * 0)).error_code == ErrorCode.SUCCESS)


def test_position_move_with_feedback(bench: Bench) -> None:
    bench.simulated.slowness = 5.0
    progress: list[float] = []
    result = bench.move(goal(), lambda message: progress.append(message.feedback.progress))
    assert result.error_code == ErrorCode.SUCCESS
    assert np.abs(np.array(result.positions) - SHAPE).max() < 0.02
    wait_until(lambda: len(progress) >= 2)  # the last may be heard behind the result
    assert progress == sorted(progress)


def test_fifteen_joints_in_any_order(bench: Bench) -> None:
    values = dict(zip(HAND.joints, SHAPE, strict=True))
    names = HAND.driven_joints[::-1]
    assert bench.move(goal([values[n] for n in names], names)).error_code == ErrorCode.SUCCESS
    assert np.abs(bench.simulated.positions - SHAPE).max() < 0.02


def test_grasp_reports_fingers_in_contact(bench: Bench) -> None:
    bench.simulated.walls = {"thumb_joint2": 0.4, "index_joint3": 0.3}
    result = bench.move(goal(mode=MoveHand.Goal.MODE_GRASP))
    assert result.error_code == ErrorCode.SUCCESS
    assert list(result.fingers_in_contact) == ["thumb", "index"]


def test_grasp_closes_the_fingers_that_the_goal_states(bench: Bench) -> None:
    bench.move(goal())
    stated = [True, False, True, False, False]
    result = bench.move(goal(mode=MoveHand.Goal.MODE_GRASP, active=stated))
    assert result.error_code == ErrorCode.SUCCESS
    assert bench.simulated.bus_end.command().active.tolist() == stated
    beyond = HAND.split(bench.simulated.positions - SHAPE)[:, 1]
    assert (beyond > 0.5 * HAND.grasp.beyond[1]).tolist() == stated and np.abs(beyond[1]) < 0.02


def test_joint_states(bench: Bench) -> None:
    bench.move(goal())
    first, *_, last = bench.client.collect(JointState, "/dexhand/joint_states", 20)
    assert list(last.name) == list(HAND.joints)
    assert np.abs(np.array(last.position) - SHAPE).max() < 0.02 and len(last.effort) == 20
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in (first, last)]
    assert stamps[1] > stamps[0] > time.time() - 60.0


@pytest.mark.parametrize(
    ("wrong", "code"),
    [
        (goal(mode=7), ErrorCode.HAND_MODE),
        (goal(SHAPE[:-1], HAND.joints[:-1]), ErrorCode.HAND_JOINT_NAMES),
        (goal(SHAPE, ["thumb_joint1", *HAND.joints[:-1]]), ErrorCode.HAND_JOINT_NAMES),
        (goal([], []), ErrorCode.HAND_JOINT_NAMES),
        (goal(changed(5, NAN)), ErrorCode.HAND_NOT_FINITE),
        (goal(speed=NAN), ErrorCode.HAND_NOT_FINITE),
        (goal(changed(5, 1.6)), ErrorCode.HAND_LIMIT),
        (goal(changed(7, 0.7)), ErrorCode.HAND_COUPLING),
        (goal(mode=MoveHand.Goal.MODE_GRASP, active=[True] * 4), ErrorCode.HAND_JOINT_NAMES),
        (goal(speed=3.0), ErrorCode.HAND_SPEED),
        (goal(speed=-1.0), ErrorCode.HAND_SPEED),
    ],
)
def test_invalid_goals_are_answered_with_a_code(bench: Bench, wrong: MoveHand.Goal, code: ErrorCode) -> None:
    result = bench.move(wrong)
    assert result.error_code == code
    assert not bench.moved()


def test_busy(bench: Bench) -> None:
    bench.simulated.slowness = 4.0
    first = bench.send(goal())
    wait_until(bench.moved)
    assert bench.move(goal(SHAPE * 0.5)).error_code == ErrorCode.HAND_BUSY
    assert bench.end(first).error_code == ErrorCode.SUCCESS


def test_cancel_holds(bench: Bench) -> None:
    bench.simulated.slowness = 5.0
    handle = bench.send(goal())
    wait_until(bench.moved)
    bench.client.wait(handle.cancel_goal_async())
    wrapped = bench.client.wait(handle.get_result_async())
    assert wrapped.status == GoalStatus.STATUS_CANCELED
    assert wrapped.result.error_code == ErrorCode.HAND_CANCELLED
    assert bench.simulated.bus_end.command().mode == "hold"
    assert bench.simulated.positions[1] < 0.7


def test_a_stop_ends_the_move_and_refuses_others_until_the_reset(bench: Bench) -> None:
    stopped = bench.client.node.create_publisher(Bool, "/dgs/stopped", LATCHED)
    bench.simulated.slowness = 5.0
    running = bench.send(goal())
    wait_until(bench.moved)
    stopped.publish(Bool(data=True))
    result = bench.end(running)
    assert result.error_code == ErrorCode.HAND_CANCELLED and "/reset" in result.message
    held = bench.simulated.positions.copy()
    result = bench.move(goal())
    assert result.error_code == ErrorCode.STOPPED and "/reset" in result.message
    assert bench.simulated.bus_end.command().mode == "hold"
    np.testing.assert_allclose(bench.simulated.positions, held, atol=0.02)
    stopped.publish(Bool(data=False))
    assert bench.move(goal(SHAPE * 0)).error_code == ErrorCode.SUCCESS, "the news may come behind the goal"


def test_blocked(bench: Bench) -> None:
    bench.simulated.walls = {"ring_joint2": 0.3}
    result = bench.move(goal())
    assert result.error_code == ErrorCode.HAND_BLOCKED
    assert "ring_joint2" in result.message and list(result.fingers_in_contact) == ["ring"]


def test_timeout(bench: Bench) -> None:
    bench.simulated.slowness = 12.0
    assert bench.move(goal()).error_code == ErrorCode.HAND_TIMEOUT


def test_silent_hand(bench: Bench) -> None:
    bench.simulated.slowness = 5.0
    handle = bench.send(goal())
    wait_until(bench.moved)
    bench.simulated.silent = True
    assert bench.end(handle).error_code == ErrorCode.HAND_SILENT
    assert bench.move(goal()).error_code == ErrorCode.HAND_SILENT


def test_fault_of_the_hand(bench: Bench) -> None:
    bench.simulated.bus_end.inject("over_current", [True, False, False, False, False])
    result = bench.move(goal())
    assert result.error_code == ErrorCode.HAND_INTERNAL and "over_current of thumb" in result.message


def test_bus_comes_later_and_ctrl_c_in_the_middle_of_a_move(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    port = free_port()
    with suite_node("hand_driver_node", ros_domain_id, tmp_path, {"port": port}) as node:
        bench = Bench(SimulatedHand(port=port, slowness=10.0), node, ros_client)
        node.wait_ready(bench.action.server_is_ready)
        wait_until(lambda: str(port) in bench.move(goal()).message)  # once the node has tried the bus
        assert bench.move(goal()).error_code == ErrorCode.HAND_BUS

        def reported() -> bool:
            (report,) = ros_client.collect(DiagnosticArray, "/diagnostics")
            return report.status[0].level == DiagnosticStatus.ERROR and str(port) in report.status[0].message

        wait_until(reported)
        with bench.simulated:
            bench.wait_connected()
            answer = bench.send(goal()).get_result_async()
            wait_until(bench.moved)
            assert not answer.done()
            assert node.interrupt() == 0
            assert bench.simulated.bus_end.command().mode == "hold"


def test_a_hand_without_a_protocol_is_refused_at_start(ros_domain_id: int, tmp_path: Path) -> None:
    for name in ("hand_driver_node", "sim_bridge_node"):
        with suite_node(name, ros_domain_id, tmp_path, environment={"DGS_HAND": "allegro"}) as node:
            assert node.wait() == 2
            assert "no protocol of the hand allegro is known; add `protocol: module:Class`" in node.log()


def test_a_hand_that_feels_and_fails_the_dexhand_021() -> None:
    done = run_as("dexhand_021", Path(__file__).with_name("of_dexhand_021.py"))
    assert done.returncode == 0, done.stdout[-6000:]


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"interface": "pigeon"}, "pigeon"),
        ({"dbc": "/nowhere/maker.dbc"}, "maker.dbc"),
        ({"max_speed": 9.0}, "max_speed"),
        ({"sped": 1.0}, "sped"),
    ],
)
def test_wrong_parameters_are_refused_at_start(
    ros_domain_id: int, tmp_path: Path, parameters: dict[str, Any], complaint: str
) -> None:
    with suite_node("hand_driver_node", ros_domain_id, tmp_path, parameters) as node:
        assert node.wait() == 2
        assert complaint in node.log()

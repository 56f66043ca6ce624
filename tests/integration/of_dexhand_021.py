"""The driver's node with the DexHand 021; `test_hand_driver.py` runs it in a process of that hand."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from dgs_interfaces.action import MoveHand
from dgs_interfaces.msg import Fingertips
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import JointState

from dgs_description.errors import ErrorCode
from dgs_description.hand import CHOICE, HAND
from tests.dgs_hand_driver.simulated_hand import SimulatedHand
from tests.integration.test_hand_driver import Bench, connected, goal
from tests.support.environment import free_port, reserved_domain_id, wait_until
from tests.support.processes import suite_node
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

SHAPE = HAND.expand(0.5 * (HAND.lower + HAND.upper)[HAND.driven])
THIS_HAND = {CHOICE: os.environ[CHOICE]}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with connected(
        SimulatedHand(time_step=0.01, wall_period=0.01, stiffness=10.0), tmp_path, THIS_HAND
    ) as bench:
        yield bench


def diagnosis(bench: Bench) -> DiagnosticStatus:
    (report,) = bench.client.collect(DiagnosticArray, "/diagnostics")
    return report.status[0]


def fingertips(bench: Bench) -> Fingertips:
    (message,) = bench.client.collect(Fingertips, "/dexhand/fingertips")
    return message


def test_moves_feels_fails_and_recovers(bench: Bench) -> None:
    simulated = bench.simulated
    result = bench.move(goal(SHAPE, HAND.joints, speed=1.5))
    assert result.error_code == ErrorCode.SUCCESS
    assert np.abs(simulated.positions - SHAPE).max() < 0.03

    # Contact that only the fingertips feel, and slip.
    simulated.forces = np.array([[2.0, 0.2], [1.0, 0.1], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    result = bench.move(goal(0.8 * SHAPE, HAND.joints, 1.5, MoveHand.Goal.MODE_GRASP))
    assert result.error_code == ErrorCode.SUCCESS
    assert list(result.fingers_in_contact) == ["thumb", "index"]
    felt = fingertips(bench)
    assert list(felt.fingers) == list(HAND.fingers)
    assert felt.normal[0] == 2.0 and felt.tangential[1] == pytest.approx(0.1)
    assert list(felt.contact) == [True, True, False, False, False] and not any(felt.slip)

    def pull() -> None:
        simulated.forces = simulated.forces + np.array([0.0, 0.8])

    for delay in (0.5, 1.5, 3.0):
        threading.Timer(delay, pull).start()
    told = bench.client.collect(Fingertips, "/dexhand/fingertips", 600)
    assert [True, True, False, False, False] in [list(message.slip) for message in told]

    # A failing motor ends the move, is named in the diagnostics, and is cleared by the next goal.
    simulated.forces = np.zeros((5, 2))
    simulated.slowness = 3.0
    handle = bench.send(goal(SHAPE * 0, HAND.joints, speed=0.5))
    wait_until(lambda: np.abs(simulated.positions).max() < 0.6 * np.abs(SHAPE).max())
    simulated.bus_end.inject("over_current", [True, False, False, False, False])
    result = bench.end(handle)
    assert result.error_code == ErrorCode.HAND_INTERNAL
    assert "over_current of thumb_joint3, thumb_joint2" in result.message
    wait_until(lambda: diagnosis(bench).level == DiagnosticStatus.ERROR)
    assert "over_current of thumb_joint3" in diagnosis(bench).message
    simulated.slowness = 1.0
    assert bench.move(goal(SHAPE, HAND.joints, speed=1.5)).error_code == ErrorCode.SUCCESS
    wait_until(lambda: diagnosis(bench).level == DiagnosticStatus.OK)

    # The hand goes, and comes back.
    simulated.bus_end.stop()
    wait_until(lambda: bench.move(goal(SHAPE, HAND.joints, 1.5)).error_code == ErrorCode.HAND_BUS)
    simulated.bus_end.start()
    bench.wait_connected()
    wait_until(lambda: bench.move(goal(SHAPE, HAND.joints, 1.5)).error_code == ErrorCode.SUCCESS)


def test_the_simulator_has_this_hand(tmp_path: Path) -> None:
    port = free_port()
    with (
        reserved_domain_id() as domain,
        RosClient(domain) as client,
        suite_node(
            "sim_bridge_node", domain, tmp_path, {"hand_port": port, "objects": 1}, environment=THIS_HAND
        ),
        suite_node("hand_driver_node", domain, tmp_path, {"port": port}, environment=THIS_HAND) as node,
    ):
        bench = Bench(SimulatedHand(), node, client)
        node.wait_ready(bench.action.server_is_ready)
        bench.wait_connected()
        assert bench.move(goal(SHAPE, HAND.joints, speed=1.0)).error_code == ErrorCode.SUCCESS
        (joints,) = client.collect(JointState, "/dexhand/joint_states")
        assert np.abs(np.array(joints.position) - SHAPE).max() < 0.09
        result = bench.move(goal(0.9 * SHAPE, HAND.joints, 1.0, MoveHand.Goal.MODE_GRASP))
        assert result.error_code == ErrorCode.SUCCESS, result.message
        assert len(fingertips(bench).normal) == HAND.finger_count

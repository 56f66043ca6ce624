"""Nodes that are killed in the middle of a run, and started again: the code, how soon, and what the next run does."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from dgs_description.errors import ErrorCode
from tests.support.environment import reserved_domain_id
from tests.support.ros_client import RosClient
from tests.support.suite import Suite

pytestmark = [pytest.mark.integration, pytest.mark.slow]

ENDS = 10.0
"""Limit of what takes 2 to 3 s on a quiet machine [s]."""
FINE = (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Suite]:
    logs = tmp_path_factory.mktemp("restarts")
    parameters = {"clear_table": {"restart_timeout": 120.0}}
    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id) as client,
        Suite(domain_id, client, logs, parameters) as suite,
    ):
        yield suite


def works(suite: Suite) -> None:
    """A new run does its work."""
    suite.wait_ready()
    result = suite.clear(max_attempts=1).end()
    assert result.error_code in FINE and result.attempts + result.pushes == 1, result.message


@pytest.mark.parametrize(
    ("node", "code", "words"),
    [
        ("arm_executor_node", ErrorCode.TASK_ARM_UNAVAILABLE, "the arm executor went"),
        ("hand_driver_node", ErrorCode.TASK_ARM_FAILED, "(224)"),
        ("sim_bridge_node", ErrorCode.TASK_ARM_FAILED, "arm or hand failed"),  # whichever misses it first
    ],
)
def test_a_node_that_dies_while_the_arm_moves_ends_the_run(
    suite: Suite, node: str, code: ErrorCode, words: str
) -> None:
    suite.reset(seed=1, objects=4)
    run = suite.clear()
    run.wait_for("transfer", suite.nodes["clear_table"])
    suite.nodes[node].kill()
    result, seconds = run.end_after(time.monotonic())
    assert result.error_code == code and words in result.message, result.message
    assert seconds < ENDS
    suite.start(node)
    works(suite)


@pytest.mark.parametrize(("node", "stage"), [("grasp_planner_node", "predict"), ("camera_node", "capture")])
def test_planner_and_camera_are_used_again(suite: Suite, node: str, stage: str) -> None:
    suite.reset(seed=2, objects=2)
    run = suite.clear(max_attempts=1)
    run.wait_for(stage, suite.nodes["clear_table"])
    suite.nodes[node].kill()
    suite.start(node)
    result = run.end()
    assert result.error_code in FINE and result.attempts + result.pushes == 1, result.message


def test_a_pick_whose_task_died_is_ended_and_the_next_run_works(suite: Suite) -> None:
    suite.reset(seed=3, objects=4)
    run = suite.clear()
    run.wait_for("transfer", suite.nodes["clear_table"])
    suite.nodes["clear_table"].kill()
    killed = time.monotonic()
    suite.nodes["arm_executor_node"].wait_for_log(
        "EXECUTION_CANCELLED: .*the node that asked for it has gone"
    )
    assert time.monotonic() - killed < ENDS
    suite.start("clear_table")
    works(suite)


def test_ctrl_c_on_all_nodes_at_once_gives_the_client_its_result(suite: Suite) -> None:
    """Last of the module: it ends the suite."""
    suite.reset(seed=4, objects=4)
    run = suite.clear()
    run.wait_for("transfer", suite.nodes["clear_table"])
    for node in suite.nodes.values():
        node.send_interrupt()
    assert run.end().error_code in (ErrorCode.TASK_CANCELLED, ErrorCode.TASK_ARM_FAILED)
    assert [node.wait() for node in suite.nodes.values()] == [0] * 6

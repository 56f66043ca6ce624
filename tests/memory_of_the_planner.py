"""The planner's memory has the ceiling that docs/running.md names, and does not grow for ever (`make soak`)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from dgs_interfaces.srv import PredictGrasps

from dgs_description.cell import CELL
from dgs_description.frames import apply
from dgs_ros.cloud_msgs import numpy_to_cloud
from tests.dgs_grasp_planner.scenes import table_scene
from tests.support.processes import NodeProcess, group_members, suite_node
from tests.support.ros_client import RosClient

pytestmark = [pytest.mark.integration, pytest.mark.slow]

CEILING = 2000.0
"""[MiB]"""
CALLERS, CALLS = 4, 24


def own_memory(node: NodeProcess) -> float:
    """Of all processes of a node, without shared memory [MiB]."""
    statuses = [Path(f"/proc/{pid}/status").read_text() for pid in group_members(node.process.pid)]
    lines = [line for status in statuses for line in status.splitlines() if line.startswith("RssAnon:")]
    return sum(int(line.split()[1]) for line in lines) / 1024


def test_many_callers_with_clouds_of_all_sizes(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    clouds = []
    for seed in range(CALLS):
        points = apply(CELL.T_base_table, table_scene(seed, int(rng.integers(1, 9))).astype(float))
        clouds.append(numpy_to_cloud(np.repeat(points, rng.integers(1, 12), axis=0), "base_link"))
    with suite_node("grasp_planner_node", ros_domain_id, tmp_path, {"torch_threads": 1}) as node:
        node.wait_for_log(r"\bready\b")

        def ask(number: int) -> float:
            request = PredictGrasps.Request(cloud=clouds[number % CALLS], seed=1)
            answer = ros_client.call(PredictGrasps, "/predict_grasps", request)
            assert answer.model_id, answer.message
            return own_memory(node)

        with ThreadPoolExecutor(CALLERS) as callers:
            used = list(callers.map(ask, range(CALLS)))
            again = list(callers.map(ask, range(CALLS // 2)))
    assert max(used + again) < CEILING
    assert max(again) < 1.25 * max(used), "what was seen before must not need more"

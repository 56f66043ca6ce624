"""The cloud recorder as a process: what it leaves behind is a whole bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from dgs_ros.cloud_msgs import cloud_to_numpy
from tests.dgs_perception.bags import write_cloud_bag
from tests.integration.camera_processes import Diagnostics, camera_node, table_clouds
from tests.support.processes import NodeProcess

pytestmark = pytest.mark.integration


def read_bag(path: Path) -> list[np.ndarray]:
    with AnyReader([path]) as reader:
        return [cloud_to_numpy(reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()]


def test_the_recorder_leaves_a_whole_bag_when_interrupted(ros_domain_id, ros_client, tmp_path):
    base = table_clouds(3, 500)
    bag = write_cloud_bag(tmp_path / "bag", base, rate=20.0)
    diagnostics = Diagnostics(ros_client, "cloud_recorder")
    recorder = NodeProcess(
        "dgs_perception",
        "cloud_recorder",
        domain_id=ros_domain_id,
        log_file=tmp_path / "recorder.log",
        parameters={"path": str(tmp_path / "copy"), "storage": "mcap", "compress": True},
    )
    with recorder, camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)):
        recorder.wait_ready(lambda: (tmp_path / "copy").exists())
        diagnostics.wait_for_clouds(3)
        assert recorder.interrupt() == 0
    copies = read_bag(tmp_path / "copy")
    assert len(copies) >= 3
    for copy in copies:
        k = round(float(copy[0, 1]) * 1000)
        np.testing.assert_allclose(copy, base[k], atol=1e-6)


def test_the_recorder_ends_when_it_has_enough(ros_domain_id, tmp_path):
    bag = write_cloud_bag(tmp_path / "bag", table_clouds(3, 500), rate=20.0)
    recorder = NodeProcess(
        "dgs_perception",
        "cloud_recorder",
        domain_id=ros_domain_id,
        log_file=tmp_path / "recorder.log",
        parameters={"path": str(tmp_path / "copy"), "max_clouds": 4},
    )
    with recorder, camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)):
        assert recorder.wait() == 0
    assert len(read_bag(tmp_path / "copy")) == 4

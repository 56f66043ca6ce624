"""`replay_bag.sh`: a recorded table goes through camera and planner without simulator and robot."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from dgs_interfaces.srv import PredictGrasps
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_ros.cloud_msgs import cloud_to_numpy
from tests.support.environment import GUARD, REPO_ROOT, ros_environment

pytestmark = pytest.mark.integration

SCRIPTS = REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts"


def test_the_script_replays_a_recorded_table(ros_domain_id, ros_client, tmp_path):
    """The bag in tests/data through camera_node and grasp_planner_node, started by the shipped script."""
    bag = shutil.copytree(REPO_ROOT / "tests/data/table_depth", tmp_path / "table #1: it's")
    command = [SCRIPTS / "replay_bag.sh", bag, "--timeout", str(GUARD)]
    environment = {**ros_environment(), "ROS_DOMAIN_ID": str(ros_domain_id)}
    with (tmp_path / "replay.log").open("wb") as log:
        script = subprocess.Popen(
            [*command, "--log", tmp_path],
            env=environment,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    try:
        clouds = ros_client.collect(PointCloud2, "/dgs/cloud", 3, qos=qos_profile_sensor_data)
        reply = ros_client.call(PredictGrasps, "/predict_grasps", PredictGrasps.Request())
        deadline = time.monotonic() + GUARD
        while reply.error_code == ErrorCode.NO_CLOUD_YET and time.monotonic() < deadline:
            # The planner may discover the camera's topic later than this test does.
            reply = ros_client.call(PredictGrasps, "/predict_grasps", PredictGrasps.Request())
        os.killpg(script.pid, signal.SIGINT)
        assert script.wait(GUARD) == 0
    finally:
        if script.poll() is None:
            os.killpg(script.pid, signal.SIGTERM)
            script.wait(GUARD)
    for cloud in clouds:
        points = cloud_to_numpy(cloud)
        assert cloud.header.frame_id == "base_link" and len(points) > 50_000
        assert abs(float(np.median(points[:, 2])) - CELL.table_height) < 0.003
        assert np.count_nonzero(points[:, 2] > CELL.table_height + 0.02) > 3000  # the objects
    trained = (REPO_ROOT / "models/dgs_net.pt").is_file()
    assert reply.error_code == (ErrorCode.SUCCESS if trained else ErrorCode.WEIGHTS_MISSING), reply.message

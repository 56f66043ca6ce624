"""Processes meet over the Fast DDS profile that is shipped: large clouds arrive, traffic stays on this machine."""

from __future__ import annotations

import queue
import xml.etree.ElementTree as ET

import pytest

pytest.importorskip("rclpy", reason="ROS is not on this machine")

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Int32

from tests.support.environment import GUARD, REPO_ROOT, reserved_domain_id, ros_environment
from tests.support.processes import NodeDied, NodeProcess, group_members

PROFILE = REPO_ROOT / "ros2_ws" / "src" / "dgs_bringup" / "config" / "fastdds.xml"
CLOUDS, POINTS = 40, 408_000
TALKER = """#!/usr/bin/env python3
import array, sys
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Int32

rclpy.init()
node = rclpy.create_node("talker")
points = node.declare_parameter("points", 0).value
publisher = node.create_publisher(PointCloud2, "/cloud", qos_profile_sensor_data)
cloud = PointCloud2(height=1, width=points, point_step=12, row_step=12 * points)
cloud.data = array.array("B", bytes(12 * points))

def answer(asked):
    cloud.header.stamp.sec = asked.data
    publisher.publish(cloud)

node.create_subscription(Int32, "/asked", answer, 10)
print("ready", flush=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
sys.exit(0)
"""
"""Publishes a cloud of the number that was asked for."""


@pytest.fixture
def talker(tmp_path, ros_domain_id):
    """Starts the talker with the given parameters, `ros2 run` and all."""
    prefix = tmp_path / "prefix"
    (prefix / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (prefix / "share/ament_index/resource_index/packages/test_talker").touch()
    (prefix / "lib/test_talker").mkdir(parents=True)
    (prefix / "lib/test_talker/talk").write_text(TALKER)
    (prefix / "lib/test_talker/talk").chmod(0o755)

    def make(**parameters) -> NodeProcess:
        return NodeProcess(
            "test_talker",
            "talk",
            domain_id=ros_domain_id,
            log_file=tmp_path / "talker.log",
            parameters=parameters,
            environment={"AMENT_PREFIX_PATH": f"{prefix}:{ros_environment()['AMENT_PREFIX_PATH']}"},
        )

    return make


@pytest.mark.integration
def test_large_clouds_reach_another_process(talker, ros_client):
    """Every cloud arrives. The next is asked for when it has come: a busy machine is slow, but loses none."""
    came = queue.Queue()
    ros_client.node.create_subscription(PointCloud2, "/cloud", came.put, qos_profile_sensor_data)
    asked = ros_client.node.create_publisher(Int32, "/asked", 10)
    with talker(points=POINTS) as process:
        process.wait_ready(lambda: asked.publish(Int32()) or not came.empty(), period=0.5)
        for number in range(1, CLOUDS + 1):
            asked.publish(Int32(data=number))
            cloud = came.get(timeout=GUARD)
            while cloud.header.stamp.sec == 0:  # answers to the first question, which was put more than once
                cloud = came.get(timeout=GUARD)
            assert cloud.header.stamp.sec == number
            assert len(cloud.data) == 12 * POINTS
        assert process.interrupt() == 0


@pytest.mark.integration
def test_a_node_that_dies_is_reported_with_its_log(talker):
    with talker(points="not a number") as process, pytest.raises(NodeDied, match="last lines of its log"):
        process.wait_for_log("never said")


@pytest.mark.integration
def test_leaving_the_block_kills_the_node_and_its_children(talker):
    with talker() as process:
        process.wait_for_log("ready")
        assert group_members(process.process.pid)
    assert process.exit_code is not None
    assert not group_members(process.process.pid)


def test_domain_ids_differ_and_are_given_back():
    with reserved_domain_id() as first, reserved_domain_id() as second:
        assert first != second
        assert {first, second} <= set(range(1, 101))


def test_profile_keeps_to_shared_memory_and_loopback():
    namespace = {"dds": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}
    root = ET.parse(PROFILE).getroot()
    transports = {
        descriptor.findtext("dds:type", namespaces=namespace): descriptor
        for descriptor in root.iterfind(".//dds:transport_descriptor", namespace)
    }
    assert set(transports) == {"SHM", "UDPv4"}
    assert transports["SHM"].findtext("dds:segment_size", namespaces=namespace) == str(64 * 1024**2)
    whitelist = [address.text for address in transports["UDPv4"].iterfind(".//dds:address", namespace)]
    assert whitelist == ["127.0.0.1"]
    assert root.findtext(".//dds:useBuiltinTransports", namespaces=namespace) == "false"

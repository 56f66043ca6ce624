"""Processes meet over the Fast DDS profile that is shipped: large clouds arrive, traffic stays on this machine."""

from __future__ import annotations

import os
import threading
import xml.etree.ElementTree as ET

import pytest

pytest.importorskip("rclpy", reason="ROS is not on this machine")

from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from tests.support.environment import REPO_ROOT, reserved_domain_id, ros_environment
from tests.support.processes import NodeDied, NodeProcess

PROFILE = REPO_ROOT / "ros2_ws" / "src" / "dgs_bringup" / "config" / "fastdds.xml"
CLOUDS = 40
TALKER = """#!/usr/bin/env python3
import array, sys
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

rclpy.init()
node = rclpy.create_node("talker")
count = node.declare_parameter("count", 0).value
publisher = node.create_publisher(PointCloud2, "/cloud", qos_profile_sensor_data)
cloud = PointCloud2(height=1, width=408_000, point_step=12, row_step=4_896_000)
cloud.data = array.array("B", bytes(4_896_000))
sent = 0

def publish():
    global sent
    if publisher.get_subscription_count() and sent < count:
        sent += 1
        cloud.header.stamp.sec = sent
        publisher.publish(cloud)
        if sent == count:
            print("all sent", flush=True)

node.create_timer(1 / 20, publish)
print("ready", flush=True)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
sys.exit(0)
"""


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
    received: list[int] = []
    everything = threading.Event()

    def take(cloud: PointCloud2) -> None:
        received.append(cloud.header.stamp.sec)
        if len(cloud.data) == 4_896_000 and received[-1] == CLOUDS:
            everything.set()

    ros_client.node.create_subscription(PointCloud2, "/cloud", take, qos_profile_sensor_data)
    with talker(count=CLOUDS) as process:
        process.wait_for_log("all sent", timeout=40.0)
        everything.wait(5.0)
        assert received == sorted(received)
        assert len(received) >= 0.9 * CLOUDS, f"{len(received)} of {CLOUDS} clouds arrived"
        assert process.interrupt() == 0


@pytest.mark.integration
def test_a_node_that_dies_is_reported_with_its_log(talker):
    with talker(count="not a number") as process, pytest.raises(NodeDied, match="last lines of its log"):
        process.wait_for_log("all sent", timeout=20.0)


@pytest.mark.integration
def test_leaving_the_block_kills_the_node(talker):
    with talker(count=0) as process:
        process.wait_for_log("ready")
    assert process.exit_code is not None
    with pytest.raises(ProcessLookupError):
        os.killpg(process.process.pid, 0)


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

"""The cloud recorder as a process: what it leaves behind is a whole bag."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from dgs_interfaces.action import GoHome
from dgs_interfaces.msg import Grasp, GraspArray
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState

from dgs_description.errors import ErrorCode
from dgs_perception import bags
from dgs_perception.cloud_recorder_node import CloudRecorderNode
from dgs_ros.base_node import LATCHED
from dgs_ros.cloud_msgs import cloud_to_numpy
from tests.dgs_perception.bags import write_cloud_bag
from tests.integration.camera_processes import Diagnostics, camera_node, table_clouds
from tests.support.environment import GUARD, wait_until
from tests.support.processes import suite_node
from tests.support.refused import refused

pytestmark = pytest.mark.integration


def read_bag(path: Path) -> list[np.ndarray]:
    with AnyReader([path]) as reader:
        return [cloud_to_numpy(reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()]


def test_the_recorder_leaves_a_whole_bag_when_interrupted(ros_domain_id, ros_client, tmp_path):
    base = table_clouds(3, 500)
    bag = write_cloud_bag(tmp_path / "bag", base, rate=20.0)
    diagnostics = Diagnostics(ros_client, "cloud_recorder")
    given = {"path": str(tmp_path / "copy"), "storage": "mcap", "compress": True}
    recorder = suite_node("cloud_recorder", ros_domain_id, tmp_path, given)
    with recorder, camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)):
        recorder.wait_ready(lambda: (tmp_path / "copy").exists())
        diagnostics.wait_for_clouds(3, key="messages")
        assert recorder.interrupt() == 0
    copies = read_bag(tmp_path / "copy")
    assert len(copies) >= 3
    for copy in copies:
        k = round(float(copy[0, 1]) * 1000)
        np.testing.assert_allclose(copy, base[k], atol=1e-6)


def test_the_recorder_ends_when_it_has_enough(ros_domain_id, tmp_path):
    bag = write_cloud_bag(tmp_path / "bag", table_clouds(3, 500), rate=20.0)
    given = {
        "path": str(tmp_path / "copy"),
        "max_messages": 4,
        "topics": ["run", "/nowhere"],
        "use_sim_time": True,
    }
    recorder = suite_node("cloud_recorder", ros_domain_id, tmp_path, given)
    with recorder, camera_node(ros_domain_id, tmp_path, source="rosbag", bag_path=str(bag)):
        assert recorder.wait() == 0
    with AnyReader([tmp_path / "copy"]) as reader:
        stamps = [stamp for _, stamp, _ in reader.messages()]
    assert len(stamps) == 4 and min(stamps) > 1e18, "no /clock: the system's time"
    assert "nobody published on" in recorder.log() and "/nowhere" in recorder.log()


def test_publishers_of_one_topic_that_offer_different_things_are_all_heard(ros_client, tmp_path):
    create, best_effort = ros_client.node.create_publisher, qos_profile_sensor_data
    publishers = [create(JointState, "/joint_states", qos) for qos in (QoSProfile(depth=10), best_effort)]
    given = [Parameter("path", value=str(tmp_path / "bag")), Parameter("topics", value=["/joint_states"])]
    node = CloudRecorderNode(context=ros_client.node.context, parameter_overrides=given)
    try:
        wait_until(lambda: node.count_publishers("/joint_states") == 2)
        node._look_for_topics()
        wait_until(lambda: all(each.get_subscription_count() for each in publishers))
    finally:
        node.stopping.set()
        node.close()
        node.destroy_node()


@pytest.mark.parametrize("topic", ["/joint-states", "/joint//states", ""])
def test_a_topic_that_cannot_be_one_is_refused_and_no_bag_is_begun(ros_client, tmp_path, topic):
    given = [Parameter("path", value=str(tmp_path / "bag")), Parameter("topics", value=["run", topic])]
    with refused(ErrorCode.PARAMETER_INVALID, f"'topics': (?=.*must not ).*'{topic}'"):
        CloudRecorderNode(context=ros_client.node.context, parameter_overrides=given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("patience", [0.0, 60.0])
def test_a_bag_keeps_to_one_clock(ros_client, tmp_path, monkeypatch, patience):
    """The recorder's own diagnostics come before the first /clock."""
    monkeypatch.setattr("dgs_perception.cloud_recorder_node.CLOCK_PATIENCE", patience)
    topics = Parameter("topics", value=["/diagnostics"])
    given = [Parameter("path", value=str(tmp_path / "bag")), topics, Parameter("use_sim_time", value=True)]
    given.append(Parameter("period", value=0.9 if patience else 0.0))
    node = CloudRecorderNode(context=ros_client.node.context, parameter_overrides=given)
    try:
        clock = SimpleNamespace(now=lambda: Time(nanoseconds=0))
        monkeypatch.setattr(node, "get_clock", lambda: clock)
        node._look_for_topics()
        if waits := "/diagnostics" in node._wanted:
            clock.now = lambda: Time(nanoseconds=5_000_000_000)
            node._look_for_topics()
        assert waits == (patience > 0) and not node._wanted
        for now in (5_000_000_000, 6_000_000_000):
            clock.now = lambda now=now: Time(nanoseconds=now)
            node._keep("/diagnostics", "std_msgs/msg/Empty", bags.SENSOR_DATA, b"\0\1\0\0\0")
    finally:
        node.stopping.set()
        node.close()
        node.destroy_node()
    with AnyReader([tmp_path / "bag"]) as reader:
        first, second = (stamp for _, stamp, _ in reader.messages())
    assert (first == 5_000_000_000) == waits and second - first < 60e9


@pytest.mark.parametrize("some", [False, True])
def test_a_run_is_recorded_with_its_own_types_and_latched_topics(ros_domain_id, ros_client, tmp_path, some):
    node = ros_client.node
    grasps, joints = (
        GraspArray(grasps=[Grasp(score=0.5, source="test")] * 2),
        JointState(name=["a"], position=[1.0]),
    )
    latched = [node.create_publisher(GraspArray, "/dgs/grasps", LATCHED) for _ in range(2)]
    for publisher in latched:
        publisher.publish(grasps)  # before anybody listens
    node.create_publisher(GoHome.Impl.FeedbackMessage, "/go_home/_action/feedback", 10)
    states = node.create_publisher(JointState, "/joint_states", 10)
    node.create_timer(0.02, lambda: states.publish(joints))
    diagnostics = Diagnostics(ros_client, "cloud_recorder")
    topics = (
        ["/joint_states", "/dgs/grasps", "/diagnostics", "/go_home/_action/feedback"] if some else ["run"]
    )
    given = {"path": str(tmp_path / "run"), "topics": topics, "storage": "mcap", "period": 0.05}
    recorder = suite_node("cloud_recorder", ros_domain_id, tmp_path, given)
    with recorder:
        diagnostics.wait_for_clouds(20, key="messages")
        assert recorder.interrupt() == 0
    with AnyReader([tmp_path / "run"]) as reader:
        assert {"/joint_states", "/dgs/grasps", "/diagnostics"} <= set(reader.topics)
        (connection,) = reader.topics["/dgs/grasps"].connections
        assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        (_, _, data), _ = reader.messages([connection])
        assert deserialize_message(data, GraspArray) == grasps
        assert [grasp.source for grasp in reader.deserialize(data, connection.msgtype).grasps] == [
            "test",
            "test",
        ]
        assert reader.topics["/joint_states"].msgcount > 5
        (connection,) = reader.topics["/joint_states"].connections
        assert connection.ext.offered_qos_profiles[0].reliability.name == "RELIABLE", "as it was offered"


def test_a_topic_of_an_unknown_package_is_left_out_and_what_cannot_be_written_is_reported(
    ros_client, tmp_path, monkeypatch
):
    kind, said = "nowhere/msg/Thing", []
    publisher = SimpleNamespace(topic_type=kind, qos_profile=qos_profile_sensor_data)
    monkeypatch.setattr(CloudRecorderNode, "get_publishers_info_by_topic", lambda *_: [publisher])
    given = [Parameter("path", value=str(tmp_path / "bag")), Parameter("topics", value=["/thing"])]
    node = CloudRecorderNode(context=ros_client.node.context, parameter_overrides=given)
    try:
        monkeypatch.setattr(node, "report", lambda level, message, **values: said.append((message, values)))
        node._keep("/thing", kind, bags.SENSOR_DATA, b"")
        node._writing.result(GUARD)
        node._keep("/thing", kind, bags.LATCHED, b"")
        assert node._waiting.empty(), "what nobody will write is not kept"
    finally:
        node.stopping.set()
        node.close()
        node.destroy_node()
    (message, values), *_ = said
    assert "cannot go on" in message and values["code"] == 402

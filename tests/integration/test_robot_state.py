"""What RViz and Foxglove need: the description, and frames that follow arm and hand."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from dgs_description.arm_kinematics import CHOICE
from dgs_description.cell import HOME_ARM
from dgs_description.frame_tree import FrameTree
from dgs_description.frames import HAND_TCP, TOOL0
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_description.link_tree import LinkTree
from dgs_description.urdf import robot
from dgs_ros.base_node import LATCHED
from dgs_ros.joint_msgs import to_joint_state
from dgs_ros.pose_msgs import transform_to_matrix
from dgs_ros.run import EXIT_REFUSED
from dgs_ros.trajectory_msgs import to_time
from tests.support.environment import GUARD, reserved_domain_id
from tests.support.processes import suite_node
from tests.support.ros_client import RosClient
from tests.support.ur_calibration import a_ur3, write

pytestmark = pytest.mark.integration


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosClient]:
    with (
        reserved_domain_id() as domain,
        RosClient(domain) as client,
        suite_node("robot_state", domain, tmp_path_factory.mktemp("logs")) as node,
    ):
        node.wait_ready(lambda: client.node.count_publishers("/robot_description"))
        yield client


def test_the_description_is_a_urdf_that_needs_no_files(client: RosClient, tmp_path: Path) -> None:
    (message,) = client.collect(String, "/robot_description", 1, LATCHED)
    root = ElementTree.fromstring(message.data)
    names = {joint.get("name") for joint in root.iter("joint")}
    assert {*ARM_JOINTS, *HAND.joints} <= names
    assert not list(root.iter("mesh"))


def test_the_frames_follow_the_joints(client: RosClient) -> None:
    frames, hand = FrameTree(), np.tile([0.1, 0.5, 0.3, 0.3], 5)
    publishers = {
        topic: client.node.create_publisher(JointState, topic, 10)
        for topic in ("/joint_states", "/dexhand/joint_states")
    }
    ticks = iter(range(1, 10**9))

    def publish() -> None:
        stamp = to_time(1000.0 + 0.1 * next(ticks))
        publishers["/joint_states"].publish(to_joint_state(ARM_JOINTS, HOME_ARM, stamp=stamp))
        publishers["/dexhand/joint_states"].publish(to_joint_state(HAND.joints, hand, stamp=stamp))

    def remember(message: TFMessage) -> None:
        for item in message.transforms:
            frames.set(item.header.frame_id, item.child_frame_id, transform_to_matrix(item.transform))

    timer, end = client.node.create_timer(0.05, publish), time.monotonic() + GUARD
    remember(*client.collect(TFMessage, "/tf_static", 1, LATCHED))
    names = (TOOL0, HAND_TCP, "thumb_tip", "little_distal")
    while any(frames.pose(name) is None for name in names):  # arm and hand are not heard at the same moment
        assert time.monotonic() < end
        (moving,) = client.collect(TFMessage, "/tf", 1)
        remember(moving)
    client.node.destroy_timer(timer)
    joints = dict(zip((*ARM_JOINTS, *HAND.joints), (*HOME_ARM, *hand), strict=True))
    expected = LinkTree(robot()).poses(joints)
    for name in names:
        np.testing.assert_allclose(frames.pose(name), expected[name], atol=1e-9)
    assert moving.transforms[0].header.stamp.sec >= 1000


def test_the_cameras_frames_are_left_to_the_camera_node(client: RosClient) -> None:
    (message,) = client.collect(TFMessage, "/tf_static", 1, LATCHED)
    assert not any("camera_link" in item.child_frame_id for item in message.transforms)


def test_the_description_of_a_calibrated_arm(ros_domain_id: int, tmp_path: Path) -> None:
    chosen = {CHOICE: str(write(tmp_path / "calibration.yaml", a_ur3()))}
    node = suite_node("robot_state", ros_domain_id, tmp_path, environment=chosen)
    with RosClient(ros_domain_id) as client, node:
        (message,) = client.collect(String, "/robot_description", 1, LATCHED)
    joints = {
        joint.get("name"): joint.find("origin")
        for joint in ElementTree.fromstring(message.data).iter("joint")
    }
    for name, origin in zip(ARM_JOINTS, a_ur3(), strict=True):
        np.testing.assert_allclose(
            [float(x) for x in joints[name].get("xyz").split()], origin[:3, 3], atol=1e-9
        )


def test_a_file_that_is_no_calibration_ends_the_node_with_a_sentence(
    ros_domain_id: int, tmp_path: Path
) -> None:
    file = tmp_path / "calibration.yaml"
    file.write_text("kinematics: {}")
    with suite_node("arm_executor_node", ros_domain_id, tmp_path, environment={CHOICE: str(file)}) as node:
        assert node.wait() == EXIT_REFUSED
    assert re.search(r"cannot start: .*calibration.yaml cannot be read .* \(code 12\)", node.log())

"""Planner, camera and hand as ROS 2's lifecycle tools see them: through the services of `ros2 lifecycle`."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from dgs_interfaces.action import MoveHand
from dgs_interfaces.srv import PredictGrasps
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from tests.dgs_perception.bags import write_cloud_bag
from tests.integration.camera_processes import table_clouds
from tests.support.processes import NodeProcess, group_members, suite_node
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


class Managed:
    """A node and its lifecycle services."""

    def __init__(self, client: RosClient, process: NodeProcess, name: str) -> None:
        self.client, self.process, self.name = client, process, name

    def state(self) -> str:
        answer = self.client.call(GetState, f"/{self.name}/get_state", GetState.Request())
        return str(answer.current_state.label)

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.client.call(ChangeState, f"/{self.name}/change_state", request).success)


@contextmanager
def managed(name: str, domain: int, client: RosClient, folder: Path, **parameters: Any) -> Iterator[Managed]:
    with suite_node(name, domain, folder, parameters) as process:
        yield Managed(client, process, name)
        assert process.interrupt() == 0, process.log()
        assert "Traceback" not in process.log()


def test_the_camera_publishes_only_while_it_is_active(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    bag, seen = tmp_path / "bag", []
    ros_client.node.create_subscription(PointCloud2, "/dgs/cloud", seen.append, qos_profile_sensor_data)
    values = {"source": "rosbag", "bag_path": str(bag), "autostart": False}
    with managed("camera_node", ros_domain_id, ros_client, tmp_path, **values) as camera:
        assert camera.state() == "unconfigured"
        assert not camera.change(Transition.TRANSITION_ACTIVATE)  # not before it is configured
        assert not camera.change(Transition.TRANSITION_CONFIGURE)  # there is no bag
        assert camera.state() == "unconfigured" and "No bag can be read" in camera.process.log()
        write_cloud_bag(bag, table_clouds(10, 1000), rate=20.0)
        assert camera.change(Transition.TRANSITION_CONFIGURE)
        assert camera.state() == "inactive"
        for _ in range(2):
            assert camera.change(Transition.TRANSITION_ACTIVATE)
            ros_client.collect(PointCloud2, "/dgs/cloud", 5, qos_profile_sensor_data)
            assert camera.change(Transition.TRANSITION_DEACTIVATE)
            camera.state()  # what was on its way has come
            before = len(seen)
            for _ in range(20):
                camera.state()
            assert len(seen) <= before + 1
        assert not camera.change(Transition.TRANSITION_CLEANUP)
        assert camera.state() == "inactive" and "end this process" in camera.process.log()
        own = segments(node_id(camera.process)) - segments(os.getpid())
    assert own and not any(Path(name).exists() for name in own)


def segments(process: int) -> set[str]:
    """DDS's shared memory that a process sees."""
    return set(re.findall(r"/dev/shm/fastrtps_[0-9a-f]{16}", Path(f"/proc/{process}/maps").read_text()))


def node_id(process: NodeProcess) -> int:
    """Of the process in the group of `ros2 run` that is the node."""
    for member in group_members(process.process.pid):
        if "fastrtps_" in Path(f"/proc/{member}/maps").read_text():
            return member
    raise AssertionError("no node")


def test_the_hand_takes_goals_only_while_it_is_active(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    goal = MoveHand.Goal(joint_names=list(HAND.joints), positions=HAND.open_hand.tolist())

    def code() -> ErrorCode:
        return ErrorCode(ros_client.run_action(MoveHand, "/dexhand/move", goal).result.error_code)

    values = {"interface": "socketcan", "channel": "can_that_is_not_there", "autostart": False}
    with managed("hand_driver_node", ros_domain_id, ros_client, tmp_path, **values) as hand:
        answer = ros_client.run_action(MoveHand, "/dexhand/move", goal).result
        assert answer.error_code == ErrorCode.NODE_INACTIVE
        assert answer.message.endswith("ros2 lifecycle set /hand_driver_node configure")
        assert hand.change(Transition.TRANSITION_CONFIGURE)
        assert code() == ErrorCode.NODE_INACTIVE
        assert hand.change(Transition.TRANSITION_ACTIVATE)
        assert code() == ErrorCode.HAND_BUS  # it has tried
        assert hand.change(Transition.TRANSITION_DEACTIVATE)
        assert code() == ErrorCode.NODE_INACTIVE
        assert hand.change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
        assert hand.state() == "finalized"
        answer = ros_client.run_action(MoveHand, "/dexhand/move", goal).result
        assert answer.message.endswith("is finalized: end its process and start it again")


def test_the_planner_answers_only_while_it_is_active(
    ros_domain_id: int, ros_client: RosClient, tmp_path: Path
) -> None:
    def code() -> ErrorCode:
        answer = ros_client.call(PredictGrasps, "/predict_grasps", PredictGrasps.Request())
        return ErrorCode(answer.error_code)

    values = {"proposers": ["level_pinch"], "autostart": False}
    place = "grasp_planner_node", ros_domain_id, ros_client, tmp_path
    with managed(*place, **values) as planner:
        assert planner.change(Transition.TRANSITION_CONFIGURE)
        assert not ros_client.node.count_services("/predict_grasps")
        assert planner.change(Transition.TRANSITION_ACTIVATE)
        assert code() == ErrorCode.NO_CLOUD_YET
        assert planner.change(Transition.TRANSITION_DEACTIVATE)
        assert code() == ErrorCode.NODE_INACTIVE
        assert planner.change(Transition.TRANSITION_ACTIVATE)
        assert code() == ErrorCode.NO_CLOUD_YET


def test_by_itself_a_node_is_active(ros_domain_id: int, ros_client: RosClient, tmp_path: Path) -> None:
    place = "hand_driver_node", ros_domain_id, ros_client, tmp_path
    with managed(*place, interface="socketcan", channel="can_that_is_not_there") as hand:
        hand.process.wait_for_log("ready")
        assert hand.state() == "active"

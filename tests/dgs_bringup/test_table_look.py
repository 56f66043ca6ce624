"""What a look takes for a cloud of now, when the simulator goes or is started again."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest
from dgs_interfaces.srv import PredictGrasps
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

from dgs_bringup.clear_table import ClearTableParameters
from dgs_bringup.ros_session import wait_until
from dgs_bringup.table_look import TableEye
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_ros.cloud_msgs import numpy_to_cloud
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


class Eye:
    """A task's eye, and the simulator whose clock it goes by."""

    def __init__(self, client: RosClient) -> None:
        self.node = client.node
        self.node.set_parameters([Parameter("use_sim_time", value=True)])
        self.clock: Publisher = self.node.create_publisher(Clock, "/clock", 1)
        self._clouds = self.node.create_publisher(PointCloud2, "/dgs/cloud", qos_profile_sensor_data)
        given = ClearTableParameters(cloud_timeout=GUARD, predict_timeout=0.0, restart_timeout=0.0)
        self._eye = TableEye(self.node, ReentrantCallbackGroup(), given)
        self._eye.open()
        self.request = PredictGrasps.Request()

    def set_clock(self, second: int) -> None:
        def told() -> bool:
            self.clock.publish(Clock(clock=Time(seconds=second).to_msg()))
            return self.node.get_clock().now().nanoseconds == second * 10**9

        assert wait_until(told, GUARD)

    def show(self, second: int) -> None:
        """A cloud taken at a time, once the eye is open."""
        cloud = numpy_to_cloud(np.zeros((1, 3)), BASE_LINK)
        cloud.header.stamp = Time(seconds=second).to_msg()

        def seen() -> bool:
            self._clouds.publish(cloud)
            return any(kept.header.stamp == cloud.header.stamp for kept in self._eye._clouds)

        assert wait_until(seen, GUARD)

    def look(self, since: int) -> ErrorCode:
        """How a look ends without a planner; the request has the cloud that was taken."""
        with pytest.raises(DgsError) as caught:
            self._eye.look(
                wait_until,
                Time(seconds=since, clock_type=self.node.get_clock().clock_type),
                self.request,
                lambda *_: None,
            )
        return caught.value.code


@pytest.fixture
def eye(ros_client: RosClient) -> Iterator[Eye]:
    return Eye(ros_client)


def test_a_simulator_that_goes_is_not_waited_for(eye: Eye) -> None:
    eye.set_clock(50)
    threading.Timer(0.5, eye.node.destroy_publisher, (eye.clock,)).start()
    begun = time.monotonic()
    assert eye.look(since=50) == ErrorCode.TASK_NO_CLOUD
    assert time.monotonic() - begun < 5.0


def test_a_clock_that_goes_on_has_a_simulator(eye: Eye) -> None:
    eye.set_clock(50)
    gone, eye.clock = eye.clock, eye.node.create_publisher(Clock, "/clock", 1)
    ended = threading.Event()

    def go_on() -> None:
        eye.node.destroy_publisher(gone)
        moment = 51
        while not ended.wait(0.05):
            eye.clock.publish(Clock(clock=Time(seconds=(moment := moment + 1)).to_msg()))

    ticking = threading.Thread(target=go_on)
    threading.Timer(0.5, ticking.start).start()
    showing = threading.Timer(3.0, eye.show, (10**6,))
    showing.start()
    assert eye.look(since=50) == ErrorCode.TASK_PLANNER_UNAVAILABLE
    ended.set()
    showing.join()
    ticking.join()


def test_a_clock_that_starts_over_is_gone_by(eye: Eye) -> None:
    eye.set_clock(100)
    eye.show(101)
    eye.set_clock(20)
    eye.show(21)
    assert eye.look(since=100) == ErrorCode.TASK_PLANNER_UNAVAILABLE
    assert eye.request.cloud.header.stamp.sec == 21

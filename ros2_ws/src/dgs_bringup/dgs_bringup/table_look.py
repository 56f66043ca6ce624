"""A look at the table: a new cloud, and what the planner finds in it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dgs_interfaces.srv import PredictGrasps
from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.subscription import Subscription
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from dgs_bringup.arm_goal import ArmGoal
from dgs_bringup.clear_table import ClearTableParameters
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_ros.grasp_msgs import grasps_from_msgs
from dgs_ros.presence import watch_publisher, watch_server
from dgs_ros.trajectory_msgs import seconds

MAX_GRASPS = 128
"""Grasps asked from the planner: some are at places that were given up, or out of the arm's reach; of one wide thing
alone there are up to sixty pushes, and doubtful grasps come after them."""

_SET_BACK = 1.0
"""A clock that is so far behind a moment that has passed belongs to a simulator that was started again [s]."""

_STANDING = 0.5
"""A clock that has not moved for so long stands [s]."""

Wait = Callable[[Callable[[], Any], float], bool]
"""Whether a condition holds within a time [s]; may raise what ends the waiting."""


@dataclass
class Look:
    """What a look gave.

    Attributes:
        answer: of the planner.
        stage_times: of capture and predict [s].
        offered: candidates that `call` was sent with.
        call: the arm's goal, where it was sent while the pick before was still going on.
    """

    answer: PredictGrasps.Response
    stage_times: dict[str, float]
    offered: tuple[int, ...] = ()
    call: ArmGoal | None = None

    def candidates(self) -> GraspSet:
        """The planner's grasps, best first. Raises DgsError TASK_PLANNER_FAILED if they are none."""
        try:
            return grasps_from_msgs(self.answer.grasps)
        except DgsError as error:
            message = f"/predict_grasps answered nonsense: {error.message}"
            raise DgsError(ErrorCode.TASK_PLANNER_FAILED, message) from error


class _SimulatorClock:
    """Whether the clock stands since its publisher went; discovery alone may lose sight of one that lives."""

    def __init__(self, node: Node) -> None:
        self._node, self._watch = node, watch_publisher(node, "/clock")
        self._ticked: tuple[int, float] = (-1, 0.0)

    def stands(self) -> bool:
        if not self._watch.lost():
            return False
        now = self._node.get_clock().now().nanoseconds
        if now != self._ticked[0]:
            self._ticked = now, time.monotonic()
        return time.monotonic() - self._ticked[1] > _STANDING


class TableEye:
    """Camera and planner as a task uses them; its methods block.

    Clouds are megabytes and come many times a second: they are subscribed to only while one is wanted.

    Attributes:
        planner: client of /predict_grasps.
    """

    def __init__(self, node: Node, group: CallbackGroup, given: ClearTableParameters) -> None:
        self.planner = node.create_client(PredictGrasps, "/predict_grasps", callback_group=group)
        self._node, self._group, self._given, self._topic = node, group, given, given.cloud_topic
        self._subscription: Subscription | None = None
        self._clouds: list[PointCloud2] = []

    def open(self) -> None:
        """Begin to take clouds in: whoever will look soon does not wait then until camera and task have met."""
        if self._subscription is None:
            self._clouds = []
            self._subscription = self._node.create_subscription(
                PointCloud2, self._topic, self._keep, qos_profile_sensor_data, callback_group=self._group
            )

    def close(self) -> None:
        """Take in no more clouds."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _keep(self, cloud: PointCloud2) -> None:
        self._clouds = [*self._clouds[-1:], cloud]

    def look(
        self, wait: Wait, since: Time, request: PredictGrasps.Request, tell: Callable[[str, str], None]
    ) -> Look:
        """Take a cloud and ask the planner.

        Args:
            wait: waits, and may give up.
            since: older clouds do not count.
            request: for the planner, which gets the cloud besides.
            tell: gets stage and sentence when a stage begins.

        Raises:
            DgsError: TASK_NO_CLOUD, TASK_PLANNER_FAILED; TASK_PLANNER_UNAVAILABLE: it went, and did not come back.
        """
        start = time.monotonic()
        tell("capture", "waiting for a cloud without the robot")
        request.cloud = self._capture(wait, since)
        seen = time.monotonic()
        tell("predict", f"{request.cloud.width * request.cloud.height} points")
        answer = self._predict(wait, request, tell)
        return Look(answer, {"capture": seen - start, "predict": time.monotonic() - seen})

    def _capture(self, wait: Wait, since: Time) -> PointCloud2:
        """A cloud with a stamp of `since` or later; where the clock starts over, of the new time."""
        least = since.nanoseconds * 1e-9

        def recent() -> list[PointCloud2]:
            nonlocal least
            now = self._node.get_clock().now().nanoseconds * 1e-9
            if now < least - _SET_BACK:
                least, self._clouds = now, []
            return [cloud for cloud in self._clouds if seconds(cloud.header.stamp) >= least]

        clock = _SimulatorClock(self._node)
        self.open()
        try:
            wait(lambda: recent() or clock.stands(), self._given.cloud_timeout)
        finally:
            self.close()
        found = recent()
        if not found and clock.stands():
            gone = f"no cloud on {self._topic}: the simulator, which publishes /clock, has gone"
            raise DgsError(ErrorCode.TASK_NO_CLOUD, gone)
        if not found:
            stamps = [seconds(cloud.header.stamp) for cloud in self._clouds]
            late = f"older ones came, the last of {stamps[-1]:.3f} s" if stamps else "none came"
            within = f"within {self._given.cloud_timeout:g} s"
            missing = f"no cloud of {least:.3f} s or later on {self._topic} {within}: {late}"
            cure = "check the camera node, and use_sim_time of both nodes"
            raise DgsError(ErrorCode.TASK_NO_CLOUD, f"{missing}; {cure}")
        return found[0]

    def _predict(
        self, wait: Wait, request: PredictGrasps.Request, tell: Callable[[str, str], None]
    ) -> PredictGrasps.Response:
        """The planner's answer; a planner that is restarted meanwhile is asked again."""
        given = self._given
        while True:
            # A request that is sent while nobody is there is lost, also for one who comes later.
            if not wait(self.planner.service_is_ready, given.restart_timeout):
                gone = f"/predict_grasps went and did not come back within {given.restart_timeout:g} s"
                raise DgsError(ErrorCode.TASK_PLANNER_UNAVAILABLE, f"{gone}: start grasp_planner_node")
            server = watch_server(self._node, "/predict_grasps")
            future = self.planner.call_async(request)
            wait(lambda: future.done() or server.lost(), given.predict_timeout)  # noqa: B023
            if future.done():
                return future.result()
            self.planner.remove_pending_request(future)
            if not server.lost():
                silent = f"/predict_grasps gave no answer within {given.predict_timeout:g} s"
                raise DgsError(ErrorCode.TASK_PLANNER_FAILED, silent)
            tell("predict", "the planner went; waiting for it to come back")

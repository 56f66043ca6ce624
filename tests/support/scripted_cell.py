"""Camera, planner and arm that answer /clear_table what a test has written down."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from dgs_interfaces.action import ClearTable, ExecuteGrasp, GoHome
from dgs_interfaces.msg import Grasp, StageTime
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import Point, Pose
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_description.errors import ErrorCode
from dgs_ros.action_client import SafeActionClient
from dgs_ros.cloud_msgs import numpy_to_cloud
from tests.support.environment import GUARD
from tests.support.ros_client import RosClient

FAST = {"settle_time": 0.0, "server_timeout": 4.0, "cloud_timeout": 4.0}
"""Two tests wait for these times; all others must not hit them on a busy machine either."""
POINTS = np.full((10, 3), 0.1, dtype=np.float32)


def grasp(x: float, score: float = 0.9) -> Grasp:
    return Grasp(
        pre_grasp_joints=[0.0] * 20,
        grasp_joints=[0.0] * 20,
        tcp_pose=Pose(position=Point(x=x, z=-0.1)), score=score, reference_point=Point(x=x, z=-0.15),
        active_fingers=[True] * 5,
    )  # fmt: skip


class ScriptedCell:
    """Camera, planner and arm that answer what the test put into `plans` and `picks`."""

    def __init__(self, client: RosClient, with_arm: bool = True) -> None:
        self.plans: list[PredictGrasps.Response] = []
        self.picks: list[ExecuteGrasp.Result] = []
        self.requests: list[PredictGrasps.Request] = []
        self.goals: list[ExecuteGrasp.Goal] = []
        self.homings: list[GoHome.Result] = []  # answers of /go_home; at home already where there are none
        self.events: list[str] = []
        self.hold = False  # the arm works until it is cancelled
        self.carries = (
            False  # the arm says that it carries out of view, and goes on when the next goal is there
        )
        self.driving = False
        self.held = False  # it carries until it is cancelled
        self.drops_follower = False  # the goal that carries ends badly, which ends the one behind it
        self.ponders = False  # the planner answers only when what is carried is where it goes
        self.mute = False  # the camera says nothing
        self.cancelled = False
        self._client = client
        self._node = client.node
        self._group = ReentrantCallbackGroup()
        self._clouds = self._node.create_publisher(PointCloud2, "/dgs/cloud", qos_profile_sensor_data)
        self._timer = self._node.create_timer(0.05, self._publish, callback_group=self._group)
        self.offer_planner()
        self.task = SafeActionClient(self._node, ClearTable, "/clear_table", callback_group=self._group)
        if with_arm:
            self.add_arm()

    def offer_planner(self) -> None:
        self.planner = self._node.create_service(
            PredictGrasps, "/predict_grasps", self._predict, callback_group=self._group
        )

    def add_arm(self) -> None:
        self.arm = ActionServer(
            self._node,
            ExecuteGrasp,
            "/execute_grasp",
            self._execute,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=self._group,
        )
        self.home = ActionServer(self._node, GoHome, "/go_home", self._bring_home, callback_group=self._group)

    def _bring_home(self, goal: Any) -> GoHome.Result:
        self.events.append("home")
        result = self.homings.pop(0) if self.homings else GoHome.Result(message="at home already")
        (goal.succeed if result.error_code == 0 else goal.abort)()
        return result

    def reset(self) -> None:
        self.plans, self.picks, self.requests, self.goals = [], [], [], []
        self.homings, self.events = [], []
        self.hold = self.mute = self.cancelled = self.carries = self.driving = self.held = False
        self.drops_follower = self.ponders = False

    def start(self, **goal: Any) -> Any:
        assert self.task.wait_for_server(timeout_sec=GUARD)
        self.feedback: list[ClearTable.Feedback] = []

        def note(message: Any) -> None:
            self.feedback.append(message.feedback)

        return self._client.wait(self.task.send_goal_async(ClearTable.Goal(**goal), feedback_callback=note))

    def run(self, **goal: Any) -> Any:
        return self._client.wait(self.start(**goal).get_result_async())

    def _publish(self) -> None:
        if not self.mute:
            stamp = self._node.get_clock().now().to_msg()
            self._clouds.publish(numpy_to_cloud(POINTS, "base_link", stamp))

    async def _predict(
        self, request: PredictGrasps.Request, response: PredictGrasps.Response
    ) -> PredictGrasps.Response:
        self.requests.append(request)
        self.events.append("look")
        if self.ponders and self.driving:
            while self.driving:
                await _tick(self._node, self._group)
            for _ in range(20):  # until the task has heard of it
                await _tick(self._node, self._group)
        if not self.plans:
            return PredictGrasps.Response(error_code=ErrorCode.NO_OBJECTS, message="only the table")
        answer = self.plans.pop(0)
        answer.header = request.cloud.header
        return answer

    def _approaches(self) -> int:
        return [told.stage for told in self.feedback].count("approach")

    async def _execute(self, goal: Any) -> ExecuteGrasp.Result:
        self.goals.append(goal.request)
        self.events.append("pick")
        told, end = self._approaches(), time.monotonic() + 1.0
        for progress in (0.0, 0.5, 1.0):
            goal.publish_feedback(ExecuteGrasp.Feedback(stage="approach", candidate=0, progress=progress))
        # An answer may overtake what was told before it; an arm takes longer than that.
        while self._approaches() == told and time.monotonic() < end and not (self.driving or self.carries):
            await _tick(self._node, self._group)
        if self.hold:
            while not goal.is_cancel_requested:
                await _tick(self._node, self._group)
            self.cancelled = True
            goal.canceled()
            return ExecuteGrasp.Result(error_code=ErrorCode.EXECUTION_CANCELLED, executed_index=0)
        if self.driving:  # behind the goal that carries
            while self.driving and not goal.is_cancel_requested:
                await _tick(self._node, self._group)
            if self.drops_follower:
                self.events.append("refused")
                goal.abort()
                return ExecuteGrasp.Result(error_code=ErrorCode.SCENE_CHANGED, executed_index=-1)
            if goal.is_cancel_requested:
                self.events.append("withdrawn")
                goal.canceled()
                return ExecuteGrasp.Result(error_code=ErrorCode.EXECUTION_CANCELLED, executed_index=-1)
        result = self.picks.pop(0)
        if self.carries and goal.request.stay_over_bin and result.executed_index >= 0:
            await self._carry(goal)
            self.events.append("released")
        if goal.is_cancel_requested:
            goal.canceled()
            return ExecuteGrasp.Result(error_code=ErrorCode.EXECUTION_CANCELLED, executed_index=0)
        (goal.succeed if result.error_code == 0 else goal.abort)()
        return result

    async def _carry(self, goal: Any) -> None:
        """Until the task has looked at the table and sent what it found, as an arm that has far to go."""
        self.driving, looks, goals = True, len(self.requests), len(self.goals)
        further = bool(self.plans) and not self.ponders
        goal.publish_feedback(ExecuteGrasp.Feedback(stage="carry", out_of_view=True))
        end = time.monotonic() + GUARD
        while (len(self.requests) == looks or (further and len(self.goals) == goals)) and (
            time.monotonic() < end and not goal.is_cancel_requested
        ):
            await _tick(self._node, self._group)
        while self.held and not goal.is_cancel_requested:
            await _tick(self._node, self._group)
        self.driving = False


async def _tick(node: Any, group: Any) -> None:
    from rclpy.task import Future

    future: Future = Future()
    timer = node.create_timer(
        0.05, lambda: None if future.done() else future.set_result(None), callback_group=group
    )
    await future
    node.destroy_timer(timer)


def plan(*xs: float) -> PredictGrasps.Response:
    return PredictGrasps.Response(grasps=[grasp(x, 0.9 - 0.01 * k) for k, x in enumerate(xs)])


def pick(code: int = 0, index: int = 0, message: str = "sentence") -> ExecuteGrasp.Result:
    return ExecuteGrasp.Result(
        error_code=int(code),
        message=message,
        executed_index=index,
        stage_times=[StageTime(stage="lift", seconds=1.5)],
    )

"""The arm executor's node: actions /execute_grasp and /go_home, services /stop and /reset, clients of arm and hand."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import ExecuteGrasp, GoHome, MoveHand
from dgs_interfaces.msg import PickPlan
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool, Float64
from std_srvs.srv import Trigger
from ur_dashboard_msgs.msg import SafetyMode
from ur_msgs.srv import SetPayload

from dgs_arm_executor.execution import Execution, Report
from dgs_arm_executor.executor_msgs import answer_to_plan, grasps_from_goal, report_to_result
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import PickAnswer
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.remote import RemoteGoal
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.situation import ArmSituation
from dgs_arm_executor.table_check import fit_table
from dgs_arm_executor.watch import TICK, RobotWatch
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, Array
from dgs_description.joints import ARM_JOINTS, HAND_JOINTS
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import LATCHED, DgsNode, end_goal
from dgs_ros.cloud_msgs import cloud_in
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import efforts_of, has_joints, positions_of
from dgs_ros.presence import Watch, watch_client
from dgs_ros.run import run


class ArmExecutorNode(DgsNode[ArmExecutorParameters]):
    """Executes one pick, or one way home, at a time."""

    def __init__(self, **node_arguments: Any) -> None:
        """Load the robot's model, subscribe to its state, offer the action and the services."""
        super().__init__("arm_executor_node", ArmExecutorParameters, **node_arguments)
        given = self.parameters
        self._watch = RobotWatch(lambda: self.get_clock().now().nanoseconds * 1e-9, given.joint_state_timeout)
        self._planner = PickPlanner(settings=given, scene_settings=given)
        self._cloud: tuple[bytes, float] | None = None
        self._busy = threading.Lock()
        group = ReentrantCallbackGroup()
        arm_action = f"/{given.controller_name.strip('/')}/follow_joint_trajectory"
        arm = SafeActionClient(self, FollowJointTrajectory, arm_action, callback_group=group)
        hand = SafeActionClient(self, MoveHand, "/dexhand/move", callback_group=group)
        service = given.payload_service
        payload = self.create_client(SetPayload, service, callback_group=group) if service else None
        self._robot = Robot(
            given,
            self._watch,
            RemoteGoal(
                arm, "the arm's controller", ErrorCode.TRAJECTORY_REJECTED, ErrorCode.CONTROLLER_UNAVAILABLE
            ),
            RemoteGoal(hand, "the hand driver", ErrorCode.HAND_UNAVAILABLE, ErrorCode.HAND_UNAVAILABLE),
            payload,
            self._see,
        )
        self._plans = self.create_publisher(PickPlan, "/dgs/pick_plan", LATCHED)
        self._subscribe()
        self.serve_action(ExecuteGrasp, "/execute_grasp", self._pick)
        self.serve_action(GoHome, "/go_home", self._go_home)
        services = MutuallyExclusiveCallbackGroup()
        self.create_service(Trigger, "/stop", self._on_stop, callback_group=services)
        self.create_service(Trigger, "/reset", self._on_reset, callback_group=services)
        self.report(Level.OK, "idle")

    def close(self) -> None:
        """Stop arm and hand if the running goal has not ended by itself; nobody watches them any more."""
        self._robot.arm.cancel()
        self._robot.hand.cancel()

    def _subscribe(self) -> None:
        newest = QoSProfile(depth=1)
        self.create_subscription(JointState, "/joint_states", self._on_arm_state, newest)
        self.create_subscription(JointState, "/dexhand/joint_states", self._on_hand_state, newest)
        watch, status = self._watch, "/io_and_status_controller"
        running, safety = f"{status}/robot_program_running", f"{status}/safety_mode"
        scaling = "/speed_scaling_state_broadcaster/speed_scaling"
        self.create_subscription(Bool, running, lambda msg: watch.program_state(bool(msg.data)), LATCHED)
        self.create_subscription(SafetyMode, safety, lambda msg: watch.safety_state(int(msg.mode)), LATCHED)
        self.create_subscription(Float64, scaling, lambda msg: watch.speed_state(msg.data), newest)
        # In the thread of the joint states: silence is judged by what that thread has seen.
        self.every(TICK, self._watch.tick, self.streams)
        self.every(1.0, self._report_robot, self.streams)
        if self.parameters.cloud_topic:
            # Raw: most clouds are never looked at, and taking one apart costs more than keeping it.
            topic = self.parameters.cloud_topic
            self.create_subscription(PointCloud2, topic, self._on_cloud, qos_profile_sensor_data, raw=True)

    # topics

    def _on_arm_state(self, msg: JointState) -> None:
        if has_joints(msg, ARM_JOINTS):  # else somebody else's
            joints = self._measured("joint states", positions_of, msg, ARM_JOINTS)
            if joints is not None:
                self._watch.arm_state(joints)

    def _on_hand_state(self, msg: JointState) -> None:
        joints = self._measured("hand states", positions_of, msg, HAND_JOINTS)
        torques = self._measured("hand torques", efforts_of, msg, HAND_JOINTS) if msg.effort else None
        if joints is not None:  # they are good without torques, too
            self._watch.hand_state(joints, torques)

    def _measured(self, what: str, read: Callable, msg: JointState, names: Sequence[str]) -> Array | None:
        try:
            return read(msg, names)
        except DgsError as error:
            level = Level.WARN if read is efforts_of else Level.ERROR
            self.report_event(level, error.message, what, code=int(error.code))
            return None

    def _report_robot(self) -> None:
        """Tell of a stop or of silence also while no goal runs; end what an executor before this one has left."""
        for part in (self._robot.arm, self._robot.hand):
            part.available()
        try:
            self._watch.check_motion()
            self.report(Level.OK, "the arm may move", "robot")
        except DgsError as error:
            level = Level.WARN if error.code == ErrorCode.JOINT_STATES_SILENT else Level.ERROR
            self.report(level, error.message, "robot", code=int(error.code))

    def _on_cloud(self, serialized: bytes) -> None:
        self._cloud = serialized, time.monotonic()

    # services

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._watch.latch(ErrorCode.STOPPED, "motion was stopped by /stop")
        self._robot.arm.cancel()
        self._robot.hand.cancel()
        self.report(Level.WARN, "stopped; call /reset to allow motion", code=int(ErrorCode.STOPPED))
        response.success, response.message = True, "arm and hand hold; no motion until /reset"
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = self._watch.reset()
            response.success = True
            self.report(Level.OK, "idle")
        except DgsError as error:
            response.message = error.message
        return response

    # the actions

    def _pick(self, goal_handle: ServerGoalHandle) -> ExecuteGrasp.Result:
        goal = goal_handle.request
        report = self._serve(
            "/execute_grasp",
            goal_handle,
            lambda execution: execution.pick(grasps_from_goal(goal), goal.plan_only, goal.keep_holding),
            lambda stage, index, share: ExecuteGrasp.Feedback(stage=stage, candidate=index, progress=share),
            lambda answer: self._plans.publish(answer_to_plan(goal, answer)),
        )
        return report_to_result(report)

    def _go_home(self, goal_handle: ServerGoalHandle) -> GoHome.Result:
        report = self._serve(
            "/go_home",
            goal_handle,
            Execution.go_home,
            lambda stage, _, share: GoHome.Feedback(stage=stage, progress=share),
        )
        code, released = int(report.code), report.object_released
        return GoHome.Result(error_code=code, message=report.message, object_released=released)

    def _serve(
        self,
        action: str,
        goal_handle: ServerGoalHandle,
        work: Callable[[Execution], Report],
        feedback: Callable[[str, int, float], Any],
        tell: Callable[[PickAnswer], None] = lambda _: None,
    ) -> Report:
        """Do one thing at a time, and answer with a report whatever happens."""
        in_use = "the arm is in use; wait for the end of the other goal or cancel it"
        report = Report(ErrorCode.EXECUTOR_BUSY, in_use)
        if self._busy.acquire(blocking=False):
            client = watch_client(self, action, goal_handle.goal_id)
            try:
                self._robot.begin(
                    lambda: self._why_cancelled(goal_handle, client),
                    lambda *progress: self._publish(goal_handle, feedback(*progress)),
                )
                report = work(Execution(self._robot, self._planner, self.parameters, tell))
            except DgsError as error:
                report = Report(error.code, error.message)
            except Exception as error:  # the client must get its answer whatever happened
                self.get_logger().error(f"the goal broke off: {error!r}")
                self._robot.arm.cancel()
                report = Report(ErrorCode.ARM_INTERNAL, f"unexpected {type(error).__name__}: {error}")
            finally:
                self._busy.release()
        self.get_logger().info(f"{report.code.name}: {report.message}")
        level = Level.OK if report.code == ErrorCode.SUCCESS else Level.WARN
        self.report(level, report.message, code=int(report.code))
        cancelled = report.code == ErrorCode.EXECUTION_CANCELLED
        end_goal(goal_handle, report.code == ErrorCode.SUCCESS, cancelled)
        return report

    def _why_cancelled(self, goal_handle: ServerGoalHandle, client: Watch) -> str:
        if goal_handle.is_cancel_requested:
            return "cancelled on request"
        if client.lost():
            return "the node that asked for it has gone"
        return "the node ends" if self.stopping.is_set() else ""

    def _publish(self, goal_handle: ServerGoalHandle, feedback: Any) -> None:
        if not self.stopping.is_set():
            goal_handle.publish_feedback(feedback)

    def _see(self, situation: ArmSituation, fresh: bool) -> ObstacleCloud:
        """The newest cloud as an obstacle, without the robot; an empty one where none has come yet.

        Raises:
            DgsError: OBSTACLES_MISSING, OBSTACLES_STALE where it is to be `fresh`; FRAME_UNKNOWN; EXTRINSICS_OFF.
        """
        topic, limit = self.parameters.cloud_topic, self.parameters.max_cloud_age
        if not topic:
            return ObstacleCloud()
        if self._cloud is None:
            sentence = f"no cloud has come on {topic}"
            self.report_event(Level.WARN, sentence, "cloud")
            if fresh:
                cure = "start the camera node, or set cloud_topic to '' to plan without"
                raise DgsError(ErrorCode.OBSTACLES_MISSING, f"{sentence}: {cure}")
            return ObstacleCloud()
        serialized, arrived = self._cloud
        age = time.monotonic() - arrived
        if fresh and age > limit:
            sentence = f"the newest cloud of {topic} came {age:.1f} s ago, {limit:g} s are allowed"
            self.report_event(Level.WARN, sentence, "cloud")
            raise DgsError(ErrorCode.OBSTACLES_STALE, f"{sentence}: check the camera")
        seen = cloud_in(deserialize_message(serialized, PointCloud2), BASE_LINK)
        points = without_robot(seen, situation.arm_joints, situation.hand_joints)
        if self.parameters.check_extrinsics:
            fit_table(points).check(self.parameters.extrinsics_tilt, self.parameters.extrinsics_height)
        cloud = ObstacleCloud.from_points(points)
        self.report(Level.OK, f"{len(cloud.points)} occupied voxels", "cloud")
        return cloud


def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT."""
    run(ArmExecutorNode, args)

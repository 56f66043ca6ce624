"""The arm executor's node: actions /execute_grasp and /go_home, services /stop and /reset, clients of arm and hand."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import ExecuteGrasp, GoHome, MoveHand
from dgs_interfaces.msg import PickPlan
from geometry_msgs.msg import WrenchStamped
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
from dgs_arm_executor.pick_plan import PickAnswer, Prepared, Wish
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.remote import RemoteGoal
from dgs_arm_executor.robot import Robot
from dgs_arm_executor.self_filter import without_robot
from dgs_arm_executor.situation import ArmSituation, Load
from dgs_arm_executor.table_check import fit_table
from dgs_arm_executor.turns import Turns
from dgs_arm_executor.view import seen_at_home
from dgs_arm_executor.watch import TICK, RobotWatch
from dgs_description.arm_kinematics import arm_kinematics
from dgs_description.cell import CELL, CHOICE
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK, Array
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import LATCHED, DgsNode, check_topic, end_goal
from dgs_ros.cloud_msgs import cloud_in
from dgs_ros.diagnostics import Level
from dgs_ros.joint_msgs import efforts_of, has_joints, positions_of
from dgs_ros.pose_msgs import to_array
from dgs_ros.presence import watch_client
from dgs_ros.run import run
from dgs_ros.static_frames import StaticFrames
from dgs_ros.trajectory_msgs import seconds

_DEAF = 1.0
"""A sensor of the wrist that has said nothing for so long, in wall time, bounds nothing [s]."""
_CAMERA_OFF = 0.05
"""A camera farther from its place in the cell than this is told [m]."""


class ArmExecutorNode(DgsNode[ArmExecutorParameters]):
    """Executes one pick, or one way home, at a time; the next pick may be planned behind one on its last way."""

    def __init__(self, **node_arguments: Any) -> None:
        """Load the robot's model, subscribe to its state, offer the action and the services."""
        super().__init__("arm_executor_node", ArmExecutorParameters, **node_arguments)
        given = self.parameters
        arm_action = f"/{given.controller_name.strip('/')}/follow_joint_trajectory"
        check_topic(self, "controller_name", arm_action)
        stopped = self.create_publisher(Bool, "/dgs/stopped", LATCHED)
        self._watch = RobotWatch(
            lambda: self.get_clock().now().nanoseconds * 1e-9,
            given.joint_state_timeout,
            lambda latched: stopped.publish(Bool(data=latched)),
            given.max_force,
        )
        self._planner = PickPlanner(settings=given, scene_settings=given)
        # For the goal that gets ready while another one drives: a planner is not for two threads.
        self._next_planner = PickPlanner(settings=given, scene_settings=given)
        self._cloud: tuple[bytes, float] | None = None
        self._frames = StaticFrames(self, self._on_frame)
        self._felt = -np.inf
        self._turns = Turns()
        group = ReentrantCallbackGroup()
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
        self.get_logger().info(f"kinematics of the arm: {arm_kinematics().name}")
        self.report(Level.OK, "idle")
        if seen := seen_at_home():
            cure = "the cell needs another home or a lower workspace_height"
            self.report(
                Level.WARN, f"at home the camera sees {seen} instead of the workspace: {cure}", "home"
            )

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
        if self.parameters.wrench_topic:
            self.create_subscription(WrenchStamped, self.parameters.wrench_topic, self._on_wrench, newest)
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
                stamp = seconds(msg.header.stamp) or self._watch.now()  # some drivers do not stamp
                self._watch.arm_state(joints, stamp)

    def _on_hand_state(self, msg: JointState) -> None:
        joints = self._measured("hand states", positions_of, msg, HAND.joints)
        torques = self._measured("hand torques", efforts_of, msg, HAND.joints) if msg.effort else None
        if joints is not None:  # they are good without torques, too
            self._watch.hand_state(joints, torques, seconds(msg.header.stamp))

    def _on_wrench(self, msg: WrenchStamped) -> None:
        force = to_array(msg.wrench.force)
        if np.isfinite(force).all():
            self._felt = time.monotonic()
            self._watch.force.measured(force, seconds(msg.header.stamp) or self._watch.now())

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
        if topic := self.parameters.wrench_topic:
            silent = time.monotonic() - self._felt > _DEAF
            nothing = f"no force comes on {topic}: what the hand presses on is not bounded"
            self.report(Level.WARN if silent else Level.OK, nothing if silent else "the hand feels", "force")
        try:
            self._watch.check_motion()
            self.report(Level.OK, "the arm may move", "robot")
        except DgsError as error:
            level = Level.WARN if error.code == ErrorCode.JOINT_STATES_SILENT else Level.ERROR
            self.report(level, error.message, "robot", code=int(error.code))

    def _on_frame(self, frame: str) -> None:
        """Tell whether /tf_static has the camera where the arm keeps away from it."""
        T_base_camera = self._frames.pose(CELL.optical_frame)
        if T_base_camera is not None:
            off = float(np.linalg.norm((T_base_camera - CELL.T_base_camera_optical)[:3, 3]))
            cure = f"name the same cell in {CHOICE} for all parts"
            elsewhere = f"the camera stands {off:.2f} m from where the arm takes it to be: {cure}"
            if off > _CAMERA_OFF:
                self.report(Level.WARN, elsewhere, "camera")
            else:
                self.report(Level.OK, "the camera stands where the arm takes it to be", "camera")

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
        wish = Wish(goal.plan_only, goal.keep_holding, goal.stay_over_bin)
        cancelled = self._cancelled(goal_handle, "/execute_grasp")

        def tell(stage: str, index: int = -1, share: float = 0.0, out_of_view: bool = False) -> None:
            message = ExecuteGrasp.Feedback(
                stage=stage, candidate=index, progress=share, out_of_view=out_of_view
            )
            self._publish(goal_handle, message)

        def publish_plan(answer: PickAnswer) -> None:
            self._plans.publish(answer_to_plan(goal, answer))

        def work() -> Report:
            start = None if wish.plan_only else self._turns.follow()
            if start is None:
                with self._turn(cancelled, tell, publish_plan) as execution:
                    return execution.pick(grasps_from_goal(goal), wish)
            prepared = self._prepare(goal, start, cancelled, tell, publish_plan)
            if prepared.answer.plan is None:
                none = prepared.answer.refusal()
                return Report(none.code, none.message, rejections=prepared.answer.rejections)
            with self._turn(cancelled, tell, following=True) as execution:
                return execution.pick_prepared(prepared, wish)

        return report_to_result(self._serve(goal_handle, work))

    def _go_home(self, goal_handle: ServerGoalHandle) -> GoHome.Result:
        cancelled = self._cancelled(goal_handle, "/go_home")

        def tell(stage: str, _: int, share: float, __: bool) -> None:
            self._publish(goal_handle, GoHome.Feedback(stage=stage, progress=share))

        def work() -> Report:
            with self._turn(cancelled, tell) as execution:
                return execution.go_home()

        report = self._serve(goal_handle, work)
        code, released = int(report.code), report.object_released
        return GoHome.Result(error_code=code, message=report.message, object_released=released)

    def _prepare(
        self,
        goal: ExecuteGrasp.Goal,
        start: ArmSituation,
        cancelled: Callable[[], str],
        tell: Callable[[str], None],
        publish_plan: Callable[[PickAnswer], None],
    ) -> Prepared:
        """As follower, plan from how the goal that drives will leave the robot, and wait until it has.

        Where no grasp is feasible nothing is waited for, and this goal does not follow any more.

        Raises:
            DgsError: SCENE_CHANGED; EXECUTION_CANCELLED; as `_see` and `RobotWatch.check_motion`.
        """
        began = time.monotonic()
        tell("planning")
        try:
            grasps = grasps_from_goal(goal)
            cloud = self._see(fresh=True, load=self._robot.load)
            answer = self._next_planner.plan(replace(start, cloud=cloud), grasps, goal.keep_holding)
            publish_plan(answer)
            prepared = Prepared(answer, cloud, time.monotonic() - began)
            tell("waiting")
            while answer.plan is not None and not self._turns.succeed(TICK):
                if why := cancelled():
                    raise DgsError(ErrorCode.EXECUTION_CANCELLED, f"{why} before anything was moved")
                self._watch.check_motion()
        except BaseException:
            self._turns.leave()
            raise
        if answer.plan is None:
            self._turns.leave()
        return prepared

    @contextmanager
    def _turn(
        self,
        cancelled: Callable[[], str],
        tell: Callable[[str, int, float, bool], None],
        publish_plan: Callable[[PickAnswer], None] = lambda _: None,
        following: bool = False,
    ) -> Iterator[Execution]:
        """Drive the robot for one goal; a follower that has succeeded does already. Raises DgsError EXECUTOR_BUSY."""
        if not following and not self._turns.take():
            in_use = "the arm is in use; wait for the end of the other goal or cancel it"
            raise DgsError(ErrorCode.EXECUTOR_BUSY, in_use)
        execution = Execution(self._robot, self._planner, self.parameters, self._turns.offer, publish_plan)
        kept = False
        try:
            self._robot.begin(cancelled, tell)
            yield execution
            kept = execution.report.code == ErrorCode.SUCCESS
        except Exception:
            self._robot.arm.cancel()
            raise
        finally:
            self._turns.end(kept)

    def _serve(self, goal_handle: ServerGoalHandle, work: Callable[[], Report]) -> Report:
        """Answer with a report whatever happens."""
        try:
            report = work()
        except DgsError as error:
            report = Report(error.code, error.message)
        except Exception as error:  # the client must get its answer whatever happened
            self.get_logger().error(f"the goal broke off\n{traceback.format_exc()}")
            report = Report(ErrorCode.ARM_INTERNAL, f"unexpected {type(error).__name__}: {error}")
        self.get_logger().info(f"{report.code.name}: {report.message}")
        level = Level.OK if report.code == ErrorCode.SUCCESS else Level.WARN
        self.report(level, report.message, code=int(report.code))
        cancelled = report.code == ErrorCode.EXECUTION_CANCELLED
        end_goal(goal_handle, report.code == ErrorCode.SUCCESS, cancelled)
        return report

    def _cancelled(self, goal_handle: ServerGoalHandle, action: str) -> Callable[[], str]:
        """What says why a goal shall end; "" = it goes on."""
        client = watch_client(self, action, goal_handle.goal_id)

        def why() -> str:
            if goal_handle.is_cancel_requested:
                return "cancelled on request"
            if client.lost():
                return "the node that asked for it has gone"
            return "the node ends" if self.stopping.is_set() else ""

        return why

    def _publish(self, goal_handle: ServerGoalHandle, feedback: Any) -> None:
        if not self.stopping.is_set():
            goal_handle.publish_feedback(feedback)

    def _see(self, fresh: bool, load: Load | None = None) -> ObstacleCloud:
        """The newest cloud as an obstacle, without the robot; an empty one where none has come yet.

        Args:
            fresh: an old cloud or none at all is refused.
            load: what is carried is no obstacle either.

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
        message = deserialize_message(serialized, PointCloud2)
        seen = cloud_in(message, BASE_LINK)
        taken = self._watch.situation_at(seconds(message.header.stamp))
        points = without_robot(seen, taken.arm_joints, taken.hand_joints, None if load is None else load.box)
        if self.parameters.check_extrinsics:
            fit_table(points).check(self.parameters.extrinsics_tilt, self.parameters.extrinsics_height)
        cloud = ObstacleCloud.from_points(points)
        self.report(Level.OK, f"{len(cloud.points)} occupied voxels", "cloud")
        return cloud


def main(args: list[str] | None = None) -> None:
    """Run the node until SIGINT."""
    run(ArmExecutorNode, args)

"""The /clear_table action: arm home, capture, predict, execute, again, until nothing graspable is left.

A run blocks one of the executor's threads and sleeps while it waits. As a coroutine it would keep the executor
spinning: rclpy resumes every unfinished task at each turn, and every resumed task wakes the executor for the next one.
"""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from action_msgs.msg import GoalStatus
from dgs_interfaces.action import ClearTable as ClearTableAction
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import PickRecord
from dgs_interfaces.srv import PredictGrasps
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from dgs_bringup.clear_table import ClearTable, ClearTableSettings, Next, Record, Step
from dgs_bringup.ros_session import wait_until
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import parameter
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import DgsNode, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import grasps_from_msgs, stage_times_to_msgs
from dgs_ros.pose_msgs import matrix_to_pose
from dgs_ros.presence import watch_server
from dgs_ros.run import run
from dgs_ros.trajectory_msgs import seconds

MAX_GRASPS = 128
"""Grasps asked from the planner: some of them are at places that were given up, or out of the arm's reach."""


@dataclass(frozen=True)
class ClearTableParameters(ClearTableSettings):
    """Parameters of the task node."""

    min_score: float = parameter(
        0.0, "Smallest score of the network, before the ranking by contacts; 0 = default.", 0.0, 1.0
    )
    settle_time: float = parameter(0.5, "Wait after the arm is home before a cloud counts [s].", 0.0)
    server_timeout: float = parameter(10.0, "Wait for planner and arm executor to appear [s].", 0.1)
    restart_timeout: float = parameter(30.0, "Wait for a planner that went to come back [s].", 0.1)
    cloud_timeout: float = parameter(20.0, "Wait for a fresh cloud [s].", 0.1)
    predict_timeout: float = parameter(60.0, "Wait for /predict_grasps [s].", 0.1)
    execute_timeout: float = parameter(300.0, "Wait for /execute_grasp [s].", 1.0)
    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node.")
    autostart: bool = parameter(False, "Start one run as soon as planner and arm are there.")
    seed: int = parameter(0, "Seed of the run started by autostart.", 0)


@dataclass
class _Run:
    """One goal in work."""

    goal: ServerGoalHandle
    task: ClearTable
    stage_times: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    told: ClearTableAction.Feedback | None = None
    """The newest feedback."""


class ClearTableNode(DgsNode[ClearTableParameters]):
    """Serves /clear_table, one run at a time."""

    def __init__(self, **node_arguments: Any) -> None:
        """Create the server and the clients of planner and arm."""
        super().__init__("clear_table", ClearTableParameters, **node_arguments)
        self._group = ReentrantCallbackGroup()
        self._busy = threading.Lock()
        self._planner = self.create_client(PredictGrasps, "/predict_grasps", callback_group=self._group)
        self._arm = SafeActionClient(self, ExecuteGrasp, "/execute_grasp", callback_group=self._group)
        self._home = SafeActionClient(self, GoHome, "/go_home", callback_group=self._group)
        self.serve_action(ClearTableAction, "/clear_table", self._execute)
        self.report(Level.OK, "idle")
        if self.parameters.autostart:
            self._own = SafeActionClient(self, ClearTableAction, "/clear_table", callback_group=self._group)
            self._autostart = self.create_timer(0.5, self._start_by_itself, callback_group=self._group)

    def _execute(self, goal: ServerGoalHandle) -> ClearTableAction.Result:
        limit = goal.request.max_attempts or self.parameters.max_attempts
        run_ = _Run(goal, ClearTable(replace(self.parameters, max_attempts=limit), goal.request.seed))
        if not self._busy.acquire(blocking=False):
            return self._finish(run_, ErrorCode.TASK_BUSY, "another run is going on")
        try:
            end = self._clear(run_)
            code, message = end.code, end.message
        except DgsError as error:
            code, message = error.code, error.message
        except Exception as error:  # the client must get its answer whatever happened
            self.get_logger().error(f"the run broke off: {error!r}")
            code, message = ErrorCode.TASK_ARM_FAILED, f"unexpected {type(error).__name__}: {error}"
        finally:
            self._busy.release()
        return self._finish(run_, code, message)

    def _clear(self, run_: _Run) -> Step:
        self._wait_for_servers(run_)
        while True:
            halt = self._bring_home(run_)
            if halt is not None:
                return halt
            since = self.get_clock().now() + Duration(seconds=self.parameters.settle_time)
            answer = self._predict(run_, self._capture(run_, since))
            step = self._after_prediction(run_, answer)
            while step.next is Next.EXECUTE:
                step = self._pick(run_, step, answer)
            if step.next is Next.END:
                return step

    def _wait_for_servers(self, run_: _Run) -> None:
        timeout = self.parameters.server_timeout
        if self._wait(run_, self._servers_are_there, timeout):
            return
        code, what = ErrorCode.TASK_ARM_UNAVAILABLE, "/execute_grasp and /go_home: start arm_executor_node"
        if not self._planner.service_is_ready():
            code, what = ErrorCode.TASK_PLANNER_UNAVAILABLE, "/predict_grasps: start grasp_planner_node"
        raise DgsError(code, f"after {timeout:g} s nobody serves {what}")

    def _servers_are_there(self) -> bool:
        arm = self._arm.server_is_ready() and self._home.server_is_ready()
        return bool(arm and self._planner.service_is_ready())

    def _bring_home(self, run_: _Run) -> Step | None:
        """Have the arm out of the camera's view, wherever the last attempt or somebody else has left it."""
        result = self._call_arm(run_, self._home, GoHome.Goal(), "/go_home")
        step = run_.task.after_homing(result.error_code, result.message, result.object_released)
        self._check_cancelled(run_)
        return step

    def _capture(self, run_: _Run, since: Time) -> PointCloud2:
        """The first cloud with a stamp of `since` or later."""
        start = time.monotonic()
        self._feedback(run_, "capture", "waiting for a cloud taken with the arm at home")
        clouds: list[PointCloud2] = []
        stamps: list[float] = []
        least = since.nanoseconds * 1e-9

        def keep(cloud: PointCloud2) -> None:
            stamps.append(seconds(cloud.header.stamp))
            if stamps[-1] >= least:
                clouds.append(cloud)

        topic, timeout = self.parameters.cloud_topic, self.parameters.cloud_timeout
        # Only while it is needed: clouds are megabytes and come many times a second.
        qos, group = qos_profile_sensor_data, self._group
        subscription = self.create_subscription(PointCloud2, topic, keep, qos, callback_group=group)
        try:
            self._wait(run_, lambda: clouds, timeout)
        finally:
            self.destroy_subscription(subscription)
        if not clouds:
            late = f"{len(stamps)} older ones came, the last of {stamps[-1]:.3f} s" if stamps else "none came"
            missing = f"no cloud of {least:.3f} s or later on {topic} within {timeout:g} s: {late}"
            cure = "check the camera node, and use_sim_time of both nodes"
            raise DgsError(ErrorCode.TASK_NO_CLOUD, f"{missing}; {cure}")
        run_.stage_times["capture"] += time.monotonic() - start
        return clouds[0]

    def _predict(self, run_: _Run, cloud: PointCloud2) -> PredictGrasps.Response:
        start = time.monotonic()
        self._feedback(run_, "predict", f"{cloud.width * cloud.height} points")
        seed, min_score = run_.task.next_seed(), self.parameters.min_score
        request = PredictGrasps.Request(cloud=cloud, max_grasps=MAX_GRASPS, min_score=min_score, seed=seed)
        request.target_region = run_.goal.request.target_region
        future, timeout = self._ask_planner(run_, request), self.parameters.predict_timeout
        if not future.done():
            silent = f"/predict_grasps gave no answer within {timeout:g} s"
            raise DgsError(ErrorCode.TASK_PLANNER_FAILED, silent)
        run_.stage_times["predict"] += time.monotonic() - start
        return future.result()

    def _ask_planner(self, run_: _Run, request: PredictGrasps.Request) -> Any:
        """The future of an answer, not done if it took too long; a planner that is restarted meanwhile is asked again.

        Raises:
            DgsError: TASK_PLANNER_UNAVAILABLE: it went, and did not come back.
        """
        timeout = self.parameters.restart_timeout
        while True:
            # A request that is sent while nobody is there is lost, also for one who comes later.
            if not self._wait(run_, self._planner.service_is_ready, timeout):
                gone = f"/predict_grasps went and did not come back within {timeout:g} s"
                raise DgsError(ErrorCode.TASK_PLANNER_UNAVAILABLE, f"{gone}: start grasp_planner_node")
            planner = watch_server(self, "/predict_grasps")
            future = self._planner.call_async(request)
            self._wait(run_, lambda: future.done() or planner.lost(), self.parameters.predict_timeout)  # noqa: B023
            if not future.done():
                self._planner.remove_pending_request(future)
            if future.done() or not planner.lost():
                return future
            self._feedback(run_, "predict", "the planner went; waiting for it to come back")

    def _after_prediction(self, run_: _Run, answer: PredictGrasps.Response) -> Step:
        try:
            candidates = grasps_from_msgs(answer.grasps)
        except DgsError as error:
            message = f"/predict_grasps answered nonsense: {error.message}"
            raise DgsError(ErrorCode.TASK_PLANNER_FAILED, message) from error
        step = run_.task.after_prediction(answer.error_code, answer.message, candidates)
        self._feedback(run_, "predicted", step.message)
        return step

    def _pick(self, run_: _Run, offer: Step, answer: PredictGrasps.Response) -> Step:
        """Offer candidates to the arm and record what came of it."""
        goal = ExecuteGrasp.Goal(header=answer.header, grasps=[answer.grasps[k] for k in offer.indices])
        result = self._call_arm(run_, self._arm, goal, "/execute_grasp")
        for refused in result.rejections:
            self.get_logger().info(f"grasp {refused.index} was refused ({refused.code}): {refused.reason}")
        for stage in result.stage_times:
            run_.stage_times[stage.stage] += stage.seconds
        executed = offer.indices[result.executed_index] if result.executed_index >= 0 else -1
        code, message, released = result.error_code, result.message, result.object_released
        attempts = run_.task.attempts
        step = run_.task.after_execution(code, message, executed, run_.stage_times, released)
        if executed >= 0:
            run_.stage_times = defaultdict(float)
            grasped = run_.task.attempts > attempts
            self._feedback(run_, "recorded", _describe(run_.task.records[-1]) if grasped else message)
        else:
            self._feedback(run_, "rejected", message)
        self._check_cancelled(run_)
        return step

    def _call_arm(self, run_: _Run, client: SafeActionClient, goal: Any, name: str) -> Any:
        """The result of an action of the arm, also of one that is cancelled because the run is."""
        start = time.monotonic()

        def forward(message: Any) -> None:
            self._feedback(run_, message.feedback.stage, name)

        server = client.watch_server()
        sent = client.send_goal_async(goal, feedback_callback=forward)
        wait_until(
            lambda: sent.done() or self._asked_to_end(run_) or server.lost(), self.parameters.server_timeout
        )
        if not sent.done():
            client.cancel_when_accepted(sent)
            self._check_cancelled(run_)
            silent = f"{name} did not answer; is the arm executor alive?"
            raise DgsError(ErrorCode.TASK_ARM_UNAVAILABLE, silent)
        handle = sent.result()
        if not handle.accepted:
            raise DgsError(ErrorCode.TASK_ARM_FAILED, "the arm executor refused the goal; see its log")
        result = handle.get_result_async()
        wait_until(
            lambda: result.done() or self._asked_to_end(run_) or server.lost(),
            self.parameters.execute_timeout,
        )
        if not result.done() and not server.lost():
            # The arm brings its motion to an end and says so; wait for that, but not for ever.
            handle.cancel_goal_async()
            wait_until(lambda: result.done() or server.lost(), self.parameters.server_timeout)
        if result.done() and result.result().status != GoalStatus.STATUS_UNKNOWN:
            return result.result().result
        self._check_cancelled(run_)
        if server.lost():
            gone = "the arm executor went; the motion in work runs to its end, and the arm holds there"
            raise DgsError(ErrorCode.TASK_ARM_UNAVAILABLE, f"{name} gave no result: {gone}")
        took = time.monotonic() - start
        raise DgsError(ErrorCode.TASK_ARM_FAILED, f"{name} gave no result within {took:.0f} s")

    def _wait(self, run_: _Run, condition: Callable[[], Any], timeout: float) -> bool:
        """Whether the condition holds within the time [s]. Raises DgsError TASK_CANCELLED if the run is to end."""
        there = wait_until(lambda: condition() or self._asked_to_end(run_), timeout)
        self._check_cancelled(run_)
        return there

    def _asked_to_end(self, run_: _Run) -> bool:
        return run_.goal.is_cancel_requested or self.stopping.is_set()

    def _check_cancelled(self, run_: _Run) -> None:
        if self._asked_to_end(run_):
            raise DgsError(ErrorCode.TASK_CANCELLED, f"cancelled; {run_.task.summary()}")

    def _feedback(self, run_: _Run, stage: str, message: str) -> None:
        counts: dict[str, Any] = {"attempts": run_.task.attempts, "successes": run_.task.successes}
        self.get_logger().debug(f"{stage}: {message}")
        self.report(Level.OK, f"{stage}: {message}", **counts)
        feedback = ClearTableAction.Feedback(stage=stage, message=message, **counts)
        if run_.goal.is_active and feedback != run_.told:  # the arm tells of a stage several times a second
            run_.told = feedback
            run_.goal.publish_feedback(feedback)

    def _finish(self, run_: _Run, code: int, message: str) -> ClearTableAction.Result:
        """Set the goal's final state and write its result."""
        end_goal(run_.goal, code == ErrorCode.SUCCESS, cancelled=True)
        if code != ErrorCode.TASK_BUSY:
            expected = code in (ErrorCode.SUCCESS, ErrorCode.TASK_CANCELLED)
            self.report(Level.OK if expected else Level.WARN, message, code=int(code))
        self.get_logger().info(f"run ended ({int(code)}): {message}")
        return ClearTableAction.Result(
            error_code=int(code),
            message=message,
            attempts=run_.task.attempts,
            successes=run_.task.successes,
            pushes=run_.task.pushes,
            records=[_record_message(record) for record in run_.task.records],
        )

    def _start_by_itself(self) -> None:
        if self._servers_are_there() and self._own.server_is_ready():
            self._autostart.cancel()
            self._own.send_goal_async(ClearTableAction.Goal(seed=self.parameters.seed))


def _describe(record: Record) -> str:
    outcome = "lifted and placed" if record.success else "failed"
    if record.code != ErrorCode.SUCCESS:
        outcome += f" ({record.code}): {record.message}"
    return f"attempt {record.attempt} with score {float(record.grasp.score):.2f} {outcome}"


def _record_message(record: Record) -> PickRecord:
    return PickRecord(
        attempt=record.attempt,
        score=float(record.grasp.score),
        source=str(record.grasp.source),
        tcp_pose=matrix_to_pose(record.grasp.pose),
        error_code=record.code,
        message=record.message,
        success=record.success,
        stage_times=stage_times_to_msgs(record.stage_times),
    )


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable `clear_table`."""
    run(ClearTableNode, args)

"""The /clear_table action: arm home, capture, predict, execute, again, until nothing graspable is left.

A run blocks one of the executor's threads and sleeps while it waits. As a coroutine it would keep the executor
spinning: rclpy resumes every unfinished task at each turn, and every resumed task wakes the executor for the next one.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from dgs_interfaces.action import ClearTable as ClearTableAction
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import PickRecord
from dgs_interfaces.srv import PredictGrasps
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2

from dgs_bringup.clear_table import ClearTable, Next, Record, Rules, Step
from dgs_bringup.ros_session import wait_until
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet
from dgs_ros.base_node import DgsNode, SafeActionClient, run
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import grasps_from_msgs, stage_times_to_msgs
from dgs_ros.parameters import parameter
from dgs_ros.pose_msgs import matrix_to_pose

CLOSING_TIME = 2.0
"""How long the node waits at its end for the arm to confirm a cancelled grasp [s]."""


@dataclass(frozen=True)
class ClearTableParameters:
    """Parameters of the task node."""

    max_attempts: int = parameter(30, "Executed grasps per run if the goal says 0.", minimum=1)
    max_grasps: int = parameter(128, "Grasps asked from the planner.", minimum=1)
    max_candidates: int = parameter(32, "Grasps offered to the arm at once.", minimum=1)
    min_score: float = parameter(
        0.0,
        "Smallest score of the network, before the ranking by contacts; 0 = default.",
        minimum=0.0,
        maximum=1.0,
    )
    failures_per_place: int = parameter(3, "Failed grasps after which a place is given up.", minimum=1)
    place_radius: float = parameter(0.06, "Failures this close belong to one place [m].", minimum=0.001)
    idle_rounds: int = parameter(3, "Looks in a row without a feasible grasp that end the run.", minimum=1)
    max_faults: int = parameter(3, "Failed motions of arm or hand in a row that end the run.", minimum=1)
    settle_time: float = parameter(0.5, "Wait after the arm is home before a cloud counts [s].", minimum=0.0)
    server_timeout: float = parameter(10.0, "Wait for planner and arm executor to appear [s].", minimum=0.1)
    cloud_timeout: float = parameter(20.0, "Wait for a fresh cloud [s].", minimum=0.1)
    predict_timeout: float = parameter(60.0, "Wait for /predict_grasps [s].", minimum=0.1)
    execute_timeout: float = parameter(300.0, "Wait for /execute_grasp [s].", minimum=1.0)
    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node.")
    autostart: bool = parameter(False, "Start one run as soon as planner and arm are there.")
    seed: int = parameter(0, "Seed of the run started by autostart.", minimum=0)


@dataclass
class _Run:
    """One goal in work."""

    goal: ServerGoalHandle
    task: ClearTable
    stage_times: dict[str, float]

    def add_time(self, stage: str, seconds: float) -> None:
        self.stage_times[stage] = self.stage_times.get(stage, 0.0) + seconds


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
        self._server = ActionServer(
            self,
            ClearTableAction,
            "/clear_table",
            execute_callback=self._execute,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=self._group,
        )
        self.report(Level.OK, "idle")
        if self.parameters.autostart:
            self._self_client = SafeActionClient(
                self, ClearTableAction, "/clear_table", callback_group=self._group
            )
            self._autostart = self.create_timer(0.5, self._start_by_itself, callback_group=self._group)

    def close(self) -> None:
        """Let a run cancel what it asked the arm for: nobody watches the arm any more."""
        if self._busy.acquire(timeout=CLOSING_TIME):
            self._busy.release()

    def _execute(self, goal: ServerGoalHandle) -> ClearTableAction.Result:
        seed, limit = goal.request.seed, goal.request.max_attempts or self.parameters.max_attempts
        run_ = _Run(goal, ClearTable(self._rules(limit), seed), {})
        if not self._busy.acquire(blocking=False):
            return self._finish(run_, Step(Next.END, "another run is going on", code=ErrorCode.TASK_BUSY))
        try:
            end = self._clear(run_)
        except DgsError as error:
            end = Step(Next.END, error.message, code=error.code)
        except Exception as error:  # the client must get its answer whatever happened
            self.get_logger().error(f"the run broke off: {error!r}")
            end = Step(
                Next.END, f"unexpected {type(error).__name__}: {error}", code=ErrorCode.TASK_ARM_FAILED
            )
        finally:
            self._busy.release()
        return self._finish(run_, end)

    def _clear(self, run_: _Run) -> Step:
        self._wait_for_servers(run_)
        while True:
            halt = self._bring_home(run_)
            if halt is not None:
                return halt
            since = self.get_clock().now() + Duration(seconds=self.parameters.settle_time)
            cloud = self._capture(run_, since)
            step, answer, candidates = self._predict(run_, cloud)
            while step.next is Next.EXECUTE:
                step = self._pick(run_, step, answer, candidates)
            if step.next is Next.END:
                return step

    def _wait_for_servers(self, run_: _Run) -> None:
        planner, timeout = self._planner.service_is_ready, self.parameters.server_timeout

        def arm() -> bool:
            return bool(self._arm.server_is_ready() and self._home.server_is_ready())

        wait_until(lambda: (planner() and arm()) or self._asked_to_end(run_), timeout)
        self._check_cancelled(run_)
        for ready, code, what in (
            (planner, ErrorCode.TASK_PLANNER_UNAVAILABLE, "/predict_grasps: start grasp_planner_node"),
            (arm, ErrorCode.TASK_ARM_UNAVAILABLE, "/execute_grasp and /go_home: start arm_executor_node"),
        ):
            if not ready():
                raise DgsError(code, f"after {timeout:g} s nobody serves {what}")

    def _capture(self, run_: _Run, since: Time) -> PointCloud2:
        """The first cloud with a stamp of `since` or later."""
        start = time.monotonic()
        self._feedback(run_, "capture", "waiting for a cloud taken with the arm at home")
        clouds: list[PointCloud2] = []
        stamps: list[float] = []

        def keep(cloud: PointCloud2) -> None:
            stamp = Time.from_msg(cloud.header.stamp, clock_type=since.clock_type)
            stamps.append(stamp.nanoseconds * 1e-9)
            if stamp >= since:
                clouds.append(cloud)

        topic, timeout = self.parameters.cloud_topic, self.parameters.cloud_timeout
        # Only while it is needed: clouds are megabytes and come many times a second.
        subscription = self.create_subscription(
            PointCloud2, topic, keep, qos_profile_sensor_data, callback_group=self._group
        )
        try:
            wait_until(lambda: clouds or self._asked_to_end(run_), timeout)
        finally:
            self.destroy_subscription(subscription)
        self._check_cancelled(run_)
        if not clouds:
            seen = (
                f"{len(stamps)} older ones came, the last of {stamps[-1]:.3f} s"
                if stamps
                else "none came at all"
            )
            raise DgsError(
                ErrorCode.TASK_NO_CLOUD,
                f"no cloud of {since.nanoseconds * 1e-9:.3f} s or later on {topic} within {timeout:g} s: {seen}; "
                "check the camera node, and use_sim_time of both nodes",
            )
        run_.add_time("capture", time.monotonic() - start)
        return clouds[0]

    def _predict(self, run_: _Run, cloud: PointCloud2) -> tuple[Step, PredictGrasps.Response, GraspSet]:
        start = time.monotonic()
        self._feedback(run_, "predict", f"{cloud.width * cloud.height} points")
        request = PredictGrasps.Request(
            cloud=cloud,
            max_grasps=self.parameters.max_grasps,
            min_score=self.parameters.min_score,
            seed=run_.task.next_seed(),
        )
        future = self._planner.call_async(request)
        timeout = self.parameters.predict_timeout
        wait_until(lambda: future.done() or self._asked_to_end(run_), timeout)
        self._check_cancelled(run_)
        if not future.done():
            self._planner.remove_pending_request(future)
            raise DgsError(
                ErrorCode.TASK_PLANNER_FAILED, f"/predict_grasps gave no answer within {timeout:g} s"
            )
        answer = future.result()
        run_.add_time("predict", time.monotonic() - start)
        try:
            candidates = grasps_from_msgs(answer.grasps)
        except DgsError as error:
            message = f"/predict_grasps answered nonsense: {error.message}"
            raise DgsError(ErrorCode.TASK_PLANNER_FAILED, message) from error
        step = run_.task.after_prediction(answer.error_code, answer.message, candidates)
        self._feedback(run_, "predicted", step.message)
        return step, answer, candidates

    def _pick(self, run_: _Run, offer: Step, answer: PredictGrasps.Response, candidates: GraspSet) -> Step:
        """Offer candidates to the arm and record what came of it."""
        goal = ExecuteGrasp.Goal(header=answer.header, grasps=[answer.grasps[k] for k in offer.indices])
        result = self._call_arm(run_, self._arm, goal, "/execute_grasp")
        for rejection in result.rejections:
            self.get_logger().info(
                f"grasp {rejection.index} was refused ({rejection.code}): {rejection.reason}"
            )
        for stage in result.stage_times:
            run_.add_time(stage.stage, stage.seconds)
        executed = offer.indices[result.executed_index] if result.executed_index >= 0 else -1
        task, before = run_.task, run_.task.attempts
        step = task.after_execution(
            result.error_code,
            result.message,
            executed,
            candidates,
            dict(run_.stage_times),
            result.object_released,
        )
        if task.attempts > before:
            run_.stage_times.clear()
            self._feedback(run_, "recorded", _describe(task.records[-1]))
        else:
            self._feedback(run_, "rejected", result.message)
        self._check_cancelled(run_)
        return step

    def _bring_home(self, run_: _Run) -> Step | None:
        """Have the arm out of the camera's view, wherever the last attempt or somebody else has left it."""
        result = self._call_arm(run_, self._home, GoHome.Goal(), "/go_home")
        step = run_.task.after_homing(result.error_code, result.message, result.object_released)
        self._check_cancelled(run_)
        return step

    def _call_arm(self, run_: _Run, client: SafeActionClient, goal: Any, name: str) -> Any:
        timeout = self.parameters.execute_timeout
        start = time.monotonic()

        def forward(message: Any) -> None:
            self._feedback(run_, message.feedback.stage, name)

        sent = client.send_goal_async(goal, feedback_callback=forward)
        wait_until(lambda: sent.done() or self._asked_to_end(run_), self.parameters.server_timeout)
        if not sent.done():
            client.cancel_when_accepted(sent)
            self._check_cancelled(run_)
            raise DgsError(
                ErrorCode.TASK_ARM_UNAVAILABLE, f"{name} did not answer; is the arm executor alive?"
            )
        handle = sent.result()
        if not handle.accepted:
            raise DgsError(ErrorCode.TASK_ARM_FAILED, "the arm executor refused the goal; see its log")
        result = handle.get_result_async()
        wait_until(lambda: result.done() or self._asked_to_end(run_) or not client.server_is_ready(), timeout)
        if not result.done() and client.server_is_ready():
            # The arm brings its motion to an end and says so; wait for that, but not for ever.
            handle.cancel_goal_async()
            wait_until(result.done, self.parameters.server_timeout)
        if result.done() and result.result().status != GoalStatus.STATUS_UNKNOWN:
            return result.result().result
        self._check_cancelled(run_)
        seconds = time.monotonic() - start
        code = ErrorCode.TASK_ARM_FAILED if client.server_is_ready() else ErrorCode.TASK_ARM_UNAVAILABLE
        raise DgsError(code, f"{name} gave no result within {seconds:.0f} s; is the arm executor alive?")

    def _asked_to_end(self, run_: _Run) -> bool:
        return run_.goal.is_cancel_requested or self.stopping.is_set()

    def _check_cancelled(self, run_: _Run) -> None:
        if self._asked_to_end(run_):
            raise DgsError(ErrorCode.TASK_CANCELLED, f"cancelled; {run_.task.summary()}")

    def _rules(self, max_attempts: int) -> Rules:
        p = self.parameters
        return Rules(
            max_attempts=max_attempts,
            max_candidates=p.max_candidates,
            failures_per_place=p.failures_per_place,
            place_radius=p.place_radius,
            idle_rounds=p.idle_rounds,
            max_faults=p.max_faults,
        )

    def _feedback(self, run_: _Run, stage: str, message: str) -> None:
        task = run_.task
        self.get_logger().debug(f"{stage}: {message}")
        self.report(Level.OK, f"{stage}: {message}", attempts=task.attempts, successes=task.successes)
        if run_.goal.is_active:
            run_.goal.publish_feedback(
                ClearTableAction.Feedback(
                    stage=stage, attempts=task.attempts, successes=task.successes, message=message
                )
            )

    def _finish(self, run_: _Run, end: Step) -> ClearTableAction.Result:
        """Set the goal's final state and write its result."""
        if end.code == ErrorCode.SUCCESS:
            run_.goal.succeed()
        elif run_.goal.is_cancel_requested:
            run_.goal.canceled()
        else:
            run_.goal.abort()
        level = Level.OK if end.code in (ErrorCode.SUCCESS, ErrorCode.TASK_CANCELLED) else Level.WARN
        if end.code != ErrorCode.TASK_BUSY:
            self.report(level, end.message, code=int(end.code))
        self.get_logger().info(f"run ended ({int(end.code)}): {end.message}")
        return ClearTableAction.Result(
            error_code=int(end.code),
            message=end.message,
            attempts=run_.task.attempts,
            successes=run_.task.successes,
            records=[_record_message(record) for record in run_.task.records],
        )

    def _start_by_itself(self) -> None:
        if (
            self._planner.service_is_ready()
            and self._arm.server_is_ready()
            and self._self_client.server_is_ready()
        ):
            self._autostart.cancel()
            self._self_client.send_goal_async(ClearTableAction.Goal(seed=self.parameters.seed))


def _describe(record: Record) -> str:
    outcome = "lifted and placed" if record.success else "failed"
    if record.code != ErrorCode.SUCCESS:
        outcome += f" ({record.code}): {record.message}"
    return f"attempt {record.attempt} with score {record.score:.2f} {outcome}"


def _record_message(record: Record) -> PickRecord:
    return PickRecord(
        attempt=record.attempt,
        score=record.score,
        source=record.source,
        tcp_pose=matrix_to_pose(record.T_base_tcp),
        error_code=int(record.code),
        message=record.message,
        success=record.success,
        stage_times=stage_times_to_msgs(record.stage_times),
    )


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable `clear_table`."""
    run(ClearTableNode, args)

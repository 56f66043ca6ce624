"""The /clear_table action: capture, predict, execute, again, until nothing graspable is left.

While the arm carries an object away or goes home from a push, and is out of the camera's way, the next grasp is looked
for and given to the arm, which plans it meanwhile. Home is where it goes before the first look, after a failure, and in
the end.

A run blocks one of the executor's threads and sleeps while it waits. As a coroutine it would keep the executor
spinning: rclpy resumes every unfinished task at each turn, and every resumed task wakes the executor for the next one.
"""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from dgs_interfaces.action import ClearTable as ClearTableAction
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import PickRecord
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from std_msgs.msg import Header

from dgs_bringup.arm_goal import ArmGoal
from dgs_bringup.clear_table import ClearTable, ClearTableSettings, Next, Record, Step
from dgs_bringup.ros_session import wait_until
from dgs_bringup.table_look import MAX_GRASPS, Look, TableEye, Timeouts
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_description.parameters import parameter
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import DgsNode, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import stage_times_to_msgs
from dgs_ros.pose_msgs import matrix_to_pose
from dgs_ros.run import run


@dataclass(frozen=True)
class ClearTableParameters(ClearTableSettings):
    """Parameters of the task node."""

    min_score: float = parameter(
        0.0, "Smallest score of the network, before the ranking by contacts; 0 = default.", 0.0, 1.0
    )
    overlap: bool = parameter(True, "Look for the next grasp and plan it while the arm is on its last way.")
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
    """One goal in work.

    Attributes:
        next_look: that was taken during the pick under way.
        out_of_view: the arm stands over the bin or at home with an empty hand, out of the camera's way.
        told: the newest feedback.
    """

    goal: ServerGoalHandle
    task: ClearTable
    stage_times: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    next_look: Look | None = None
    out_of_view: bool = False
    told: ClearTableAction.Feedback | None = None


class ClearTableNode(DgsNode[ClearTableParameters]):
    """Serves /clear_table, one run at a time."""

    def __init__(self, **node_arguments: Any) -> None:
        """Create the server and the clients of planner and arm."""
        super().__init__("clear_table", ClearTableParameters, **node_arguments)
        self._group = ReentrantCallbackGroup()
        self._busy = threading.Lock()
        self._eye = TableEye(self, self._group, self.parameters.cloud_topic)
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
            self._drop_next(run_)
            self._busy.release()
        return self._finish(run_, code, message)

    def _clear(self, run_: _Run) -> Step:
        self._wait_for_servers(run_)
        while True:
            look = run_.next_look
            if look is None:
                halt = None if run_.out_of_view else self._bring_home(run_)
                if halt is not None:
                    return halt
                look = self._look(run_)
            step = self._after_prediction(run_, look)
            run_.next_look = None
            while step.next is Next.EXECUTE:
                step = self._pick(run_, step, look)
            if step.next is Next.END:
                expected = step.code in (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)
                halt = self._bring_home(run_) if run_.out_of_view and expected else None
                return halt or step

    def _wait_for_servers(self, run_: _Run) -> None:
        timeout = self.parameters.server_timeout
        if self._wait(run_, self._servers_are_there, timeout):
            return
        code, what = ErrorCode.TASK_ARM_UNAVAILABLE, "/execute_grasp and /go_home: start arm_executor_node"
        if not self._eye.planner.service_is_ready():
            code, what = ErrorCode.TASK_PLANNER_UNAVAILABLE, "/predict_grasps: start grasp_planner_node"
        raise DgsError(code, f"after {timeout:g} s nobody serves {what}")

    def _servers_are_there(self) -> bool:
        arm = self._arm.server_is_ready() and self._home.server_is_ready()
        return bool(arm and self._eye.planner.service_is_ready())

    def _bring_home(self, run_: _Run) -> Step | None:
        """Have the arm out of the camera's view, wherever the last attempt or somebody else has left it."""
        result = self._result(run_, self._send(run_, self._home, "/go_home", GoHome.Goal(), run_.task))
        run_.out_of_view = False
        step = run_.task.after_homing(result.error_code, result.message, result.object_released)
        self._check_cancelled(run_)
        return step

    def _look(self, run_: _Run, ahead: ClearTable | None = None) -> Look:
        """`ahead`: the run as it will be after the pick that is going on."""
        given, task = self.parameters, ahead or run_.task
        since = self.get_clock().now()
        request = PredictGrasps.Request(
            max_grasps=MAX_GRASPS,
            min_score=given.min_score,
            seed=run_.task.next_seed(),
            target_region=run_.goal.request.target_region,
            failed=[
                PoseStamped(header=Header(frame_id=BASE_LINK), pose=matrix_to_pose(T))
                for T in task.failed.poses
            ],
        )
        if ahead is None and not run_.out_of_view:
            since += Duration(seconds=given.settle_time)
        return self._eye.look(
            lambda condition, timeout: self._wait(run_, condition, timeout),
            since,
            request,
            Timeouts(given.cloud_timeout, given.predict_timeout, given.restart_timeout),
            lambda stage, message: self._feedback(run_, stage, message, attempt=task.attempts + 1),
        )

    def _after_prediction(self, run_: _Run, look: Look) -> Step:
        """Decide on a look, and keep the goal that was sent for it only where it is what is offered now."""
        for stage, took in look.stage_times.items():
            run_.stage_times[stage] += took
        answer = look.answer
        step = run_.task.after_prediction(answer.error_code, answer.message, look.candidates())
        self._feedback(run_, "predicted", step.message)
        if look.call is not None and (step.next is not Next.EXECUTE or step.indices != look.offered):
            self._withdraw(look.call)
            look.call = None
        return step

    def _pick(self, run_: _Run, offer: Step, look: Look) -> Step:
        """Offer candidates to the arm, look for the next grasp on its last way, and record what came of it."""
        call, look.call = look.call or self._send_pick(run_, look.answer, offer.indices), None
        if self.parameters.overlap and not run_.task.on_the_last_attempt:
            run_.next_look = self._look_ahead(run_, call, offer)
        result = self._result(run_, call)
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
            run_.out_of_view = call.out_of_view and code == ErrorCode.SUCCESS
            grasped = run_.task.attempts > attempts
            sentence = _describe(run_.task.records[-1]) if grasped else message
            self._feedback(run_, "recorded", sentence, attempt=attempts + 1)
        else:
            self._feedback(run_, "rejected", message)
        if not run_.out_of_view:
            self._drop_next(run_)
        self._check_cancelled(run_)
        return step

    def _look_ahead(self, run_: _Run, call: ArmGoal, offer: Step) -> Look | None:
        """Look for the next grasp while the arm is on its last way, and let it plan that; None if that fails."""

        def clear() -> bool:
            if call.stage in ("carry", "home"):
                self._eye.open()
            return call.out_of_view or call.done() or self._asked_to_end(run_)

        try:
            wait_until(clear, self.parameters.execute_timeout)
            if not call.out_of_view:
                return None
            foreseen = run_.task.if_it_succeeds(offer.indices[call.candidate])
            look = self._look(run_, foreseen)
            answer = look.answer
            look.offered = foreseen.after_prediction(
                answer.error_code, answer.message, look.candidates()
            ).indices
        except DgsError as error:  # the pick goes on; the look after it will tell
            self.get_logger().info(f"no look ahead ({int(error.code)}): {error.message}")
            return None
        finally:
            self._eye.close()
        if look.offered:
            look.call = self._send_pick(run_, answer, look.offered, foreseen)
        return look

    def _send_pick(
        self,
        run_: _Run,
        answer: PredictGrasps.Response,
        indices: tuple[int, ...],
        ahead: ClearTable | None = None,
    ) -> ArmGoal:
        task = ahead or run_.task
        stay = self.parameters.overlap and not task.on_the_last_attempt
        grasps = [answer.grasps[k] for k in indices]
        goal = ExecuteGrasp.Goal(header=answer.header, grasps=grasps, stay_over_bin=stay)
        return self._send(run_, self._arm, "/execute_grasp", goal, task)

    def _send(self, run_: _Run, client: SafeActionClient, name: str, goal: Any, task: ClearTable) -> ArmGoal:
        attempt = task.attempts + 1
        return ArmGoal(
            client, name, goal, lambda stage, message: self._feedback(run_, stage, message, attempt=attempt)
        )

    def _result(self, run_: _Run, call: ArmGoal) -> Any:
        """Of a goal of the arm, also of one that is cancelled because the run is."""

        def asked_to_end() -> bool:
            if self._asked_to_end(run_) and run_.next_look is not None and run_.next_look.call is not None:
                run_.next_look.call.cancel()  # first, or it would start where the other one ends
            return self._asked_to_end(run_)

        given = self.parameters
        try:
            result = call.result(asked_to_end, given.server_timeout, given.execute_timeout)
        except DgsError:
            self._check_cancelled(run_)
            raise
        if result is None:
            self._check_cancelled(run_)
        return result

    def _drop_next(self, run_: _Run) -> None:
        """Forget what was prepared for the next pick."""
        look, run_.next_look = run_.next_look, None
        if look is not None and look.call is not None:
            self._withdraw(look.call)

    def _withdraw(self, call: ArmGoal) -> None:
        """Cancel a goal, and wait until the arm is free of it."""
        call.cancel()
        wait_until(call.done, self.parameters.server_timeout)

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

    def _feedback(self, run_: _Run, stage: str, message: str, attempt: int | None = None) -> None:
        """Tell of a stage of an attempt, by default of the one that is next on the record."""
        counts: dict[str, Any] = {"attempts": run_.task.attempts, "successes": run_.task.successes}
        number = attempt or run_.task.attempts + 1
        self.get_logger().debug(f"{stage}: {message}")
        self.report(Level.OK, f"{stage}: {message}", **counts)
        if run_.goal.is_active:
            feedback = ClearTableAction.Feedback(stage=stage, message=message, attempt=number, **counts)
            if feedback != run_.told:  # the arm tells of a stage several times a second
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

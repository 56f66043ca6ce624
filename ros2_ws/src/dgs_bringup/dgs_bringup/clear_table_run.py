"""One run of /clear_table: capture, predict, execute, again, until nothing graspable is left.

While the arm carries an object away or goes home from a push, and is out of the camera's way, the next grasp is looked
for and given to the arm, which plans it meanwhile. Home is where it goes before the first look, after a failure, and in
the end.

A run blocks one of the executor's threads and sleeps while it waits. As a coroutine it would keep the executor
spinning: rclpy resumes every unfinished task at each turn, and every resumed task wakes the executor for the next one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from dgs_interfaces.action import ClearTable as ClearTableAction
from dgs_interfaces.action import ExecuteGrasp, GoHome
from dgs_interfaces.msg import PickRecord
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import CallbackGroup
from rclpy.duration import Duration
from std_msgs.msg import Header

from dgs_bringup.arm_goal import ArmGoal
from dgs_bringup.clear_table import ClearTable, ClearTableParameters, Next, Record, Step
from dgs_bringup.ros_session import wait_until
from dgs_bringup.table_look import MAX_GRASPS, Look, TableEye
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import BASE_LINK
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.grasp_msgs import stage_times_to_msgs
from dgs_ros.pose_msgs import matrix_to_pose


class Partners:
    """Camera, planner and arm, as all runs of a node use them."""

    def __init__(self, node: DgsNode[ClearTableParameters], group: CallbackGroup) -> None:
        self.eye = TableEye(node, group, node.parameters)
        self.arm = SafeActionClient(node, ExecuteGrasp, "/execute_grasp", callback_group=group)
        self.home = SafeActionClient(node, GoHome, "/go_home", callback_group=group)

    def there(self) -> bool:
        """Whether planner and arm can be asked."""
        arm = self.arm.server_is_ready() and self.home.server_is_ready()
        return bool(arm and self.eye.planner.service_is_ready())


class ClearTableRun:
    """One goal in work."""

    def __init__(
        self, node: DgsNode[ClearTableParameters], partners: Partners, goal: ServerGoalHandle
    ) -> None:
        """Begin with an empty record; nothing is asked of anybody yet."""
        self._node, self._partners, self._goal = node, partners, goal
        self._given = node.parameters
        limit = goal.request.max_attempts or self._given.max_attempts
        self._task = ClearTable(replace(self._given, max_attempts=limit), goal.request.seed)
        self._stage_times: defaultdict[str, float] = defaultdict(float)
        self._next_look: Look | None = None
        """That was taken during the pick under way."""
        self._out_of_view = False
        """The arm stands over the bin or at home with an empty hand, out of the camera's way."""
        self._at_home = False
        """It was brought there, or the last attempt that is allowed ended there by itself."""
        self._told: ClearTableAction.Feedback | None = None
        """The newest feedback."""

    def clear(self) -> Step:
        """Go on until the step END. Raises DgsError: a server failed or is missing, or the run was asked to end."""
        try:
            return self._clear()
        finally:
            self._drop_next()

    def result(self, code: int, message: str) -> ClearTableAction.Result:
        """What the run has come to."""
        return ClearTableAction.Result(
            error_code=int(code),
            message=message,
            attempts=self._task.attempts,
            successes=self._task.successes,
            pushes=self._task.pushes,
            records=[_record_message(record) for record in self._task.records],
        )

    def _clear(self) -> Step:
        self._wait_for_servers()
        while True:
            look = self._next_look
            if look is None:
                halt = None if self._out_of_view else self._bring_home()
                if halt is not None:
                    return halt
                look = self._look()
            step = self._after_prediction(look)
            self._next_look = None
            while step.next is Next.EXECUTE:
                step = self._pick(step, look)
            if step.next is Next.END:
                expected = step.code in (ErrorCode.SUCCESS, ErrorCode.TASK_ATTEMPTS_USED_UP)
                halt = self._bring_home() if expected and not self._at_home else None
                return halt or step

    def _wait_for_servers(self) -> None:
        timeout = self._given.server_timeout
        if self._wait(self._partners.there, timeout):
            return
        code, what = ErrorCode.TASK_ARM_UNAVAILABLE, "/execute_grasp and /go_home: start arm_executor_node"
        if not self._partners.eye.planner.service_is_ready():
            code, what = ErrorCode.TASK_PLANNER_UNAVAILABLE, "/predict_grasps: start grasp_planner_node"
        raise DgsError(code, f"after {timeout:g} s nobody serves {what}")

    def _bring_home(self) -> Step | None:
        """Have the arm out of the camera's view, wherever the last attempt or somebody else has left it."""
        result = self._result(self._send(self._partners.home, "/go_home", GoHome.Goal(), self._task))
        self._out_of_view, self._at_home = False, True
        step = self._task.after_homing(result.error_code, result.message, result.object_released)
        self._check_cancelled()
        return step

    def _look(self, ahead: ClearTable | None = None) -> Look:
        """`ahead`: the run as it will be after the pick that is going on."""
        task = ahead or self._task
        since = self._node.get_clock().now()
        request = PredictGrasps.Request(
            max_grasps=MAX_GRASPS,
            min_score=self._given.min_score,
            seed=self._task.next_seed(),
            target_region=self._goal.request.target_region,
            failed=[
                PoseStamped(header=Header(frame_id=BASE_LINK), pose=matrix_to_pose(T))
                for T in task.failed.poses
            ],
        )
        if ahead is None and not self._out_of_view:
            since += Duration(seconds=self._given.settle_time)
        tell = partial(self._feedback, attempt=task.attempts + 1)
        return self._partners.eye.look(self._wait, since, request, tell)

    def _after_prediction(self, look: Look) -> Step:
        """Decide on a look, and keep the goal that was sent for it only where it is what is offered now."""
        for stage, took in look.stage_times.items():
            self._stage_times[stage] += took
        answer = look.answer
        step = self._task.after_prediction(answer.error_code, answer.message, look.candidates())
        self._feedback("predicted", step.message)
        if look.call is not None and (step.next is not Next.EXECUTE or step.indices != look.offered):
            self._withdraw(look.call)
            look.call = None
        return step

    def _pick(self, offer: Step, look: Look) -> Step:
        """Offer candidates to the arm, look for the next grasp on its last way, and record what came of it."""
        call, look.call = look.call or self._send_pick(look.answer, offer.indices, self._task), None
        if self._given.overlap and not self._task.on_the_last_attempt:
            self._next_look = self._look_ahead(call, offer)
        result = self._result(call)
        for refused in result.rejections:
            reason = f"({refused.code}): {refused.reason}"
            self._node.get_logger().info(f"grasp {refused.index} was refused {reason}")
        for stage in result.stage_times:
            self._stage_times[stage.stage] += stage.seconds
        executed = offer.indices[result.executed_index] if result.executed_index >= 0 else -1
        code, message, released = result.error_code, result.message, result.object_released
        attempts = self._task.attempts
        step = self._task.after_execution(code, message, executed, self._stage_times, released)
        if executed >= 0:
            self._stage_times = defaultdict(float)
            self._out_of_view = call.out_of_view and code == ErrorCode.SUCCESS
            self._at_home = code == ErrorCode.SUCCESS and not self._out_of_view
            grasped = self._task.attempts > attempts
            sentence = _describe(self._task.records[-1]) if grasped else message
            self._feedback("recorded", sentence, attempt=attempts + 1)
        else:
            self._feedback("rejected", message)
        if not self._out_of_view:
            self._drop_next()
        self._check_cancelled()
        return step

    def _look_ahead(self, call: ArmGoal, offer: Step) -> Look | None:
        """Look for the next grasp while the arm is on its last way, and let it plan that; None if that fails."""
        eye = self._partners.eye

        def clear() -> bool:
            if call.stage in ("carry", "home"):
                eye.open()
            return call.out_of_view or call.done() or self._asked_to_end()

        try:
            wait_until(clear, self._given.execute_timeout)
            if not call.out_of_view:
                return None
            foreseen = self._task.if_it_succeeds(offer.indices[call.candidate])
            look = self._look(foreseen)
            answer = look.answer
            look.offered = foreseen.after_prediction(
                answer.error_code, answer.message, look.candidates()
            ).indices
        except DgsError as error:  # the pick goes on; the look after it will tell
            self._node.get_logger().info(f"no look ahead ({int(error.code)}): {error.message}")
            return None
        finally:
            eye.close()
        if look.offered and not call.done():  # else how it ended decides
            look.call = self._send_pick(answer, look.offered, foreseen)
        return look

    def _send_pick(
        self, answer: PredictGrasps.Response, indices: tuple[int, ...], task: ClearTable
    ) -> ArmGoal:
        stay = self._given.overlap and not task.on_the_last_attempt
        grasps = [answer.grasps[k] for k in indices]
        goal = ExecuteGrasp.Goal(header=answer.header, grasps=grasps, stay_over_bin=stay)
        return self._send(self._partners.arm, "/execute_grasp", goal, task)

    def _send(self, client: SafeActionClient, name: str, goal: Any, task: ClearTable) -> ArmGoal:
        return ArmGoal(client, name, goal, partial(self._feedback, attempt=task.attempts + 1))

    def _result(self, call: ArmGoal) -> Any:
        """Of a goal of the arm, also of one that is cancelled because the run is."""

        def asked_to_end() -> bool:
            if self._asked_to_end() and self._next_look is not None and self._next_look.call is not None:
                self._next_look.call.cancel()  # first, or it would start where the other one ends
            return self._asked_to_end()

        try:
            result = call.result(asked_to_end, self._given.server_timeout, self._given.execute_timeout)
        except DgsError:
            self._check_cancelled()
            raise
        if result is None:
            self._check_cancelled()
        return result

    def _drop_next(self) -> None:
        """Forget what was prepared for the next pick."""
        look, self._next_look = self._next_look, None
        if look is not None and look.call is not None:
            self._withdraw(look.call)

    def _withdraw(self, call: ArmGoal) -> None:
        """Cancel a goal, and wait until the arm is free of it."""
        call.cancel()
        wait_until(call.done, self._given.server_timeout)

    def _wait(self, condition: Callable[[], Any], timeout: float) -> bool:
        """Whether the condition holds within the time [s]. Raises DgsError TASK_CANCELLED if the run is to end."""
        there = wait_until(lambda: condition() or self._asked_to_end(), timeout)
        self._check_cancelled()
        return there

    def _asked_to_end(self) -> bool:
        return self._goal.is_cancel_requested or self._node.stopping.is_set()

    def _check_cancelled(self) -> None:
        if self._asked_to_end():
            raise DgsError(ErrorCode.TASK_CANCELLED, f"cancelled; {self._task.summary()}")

    def _feedback(self, stage: str, message: str, attempt: int | None = None) -> None:
        """Tell of a stage of an attempt, by default of the one that is next on the record."""
        counts: dict[str, Any] = {"attempts": self._task.attempts, "successes": self._task.successes}
        number = attempt or self._task.attempts + 1
        self._node.get_logger().debug(f"{stage}: {message}")
        if self._goal.is_active:  # else the run has said already how it ended
            self._node.report(Level.OK, f"{stage}: {message}", **counts)
            feedback = ClearTableAction.Feedback(stage=stage, message=message, attempt=number, **counts)
            if feedback != self._told:  # the arm tells of a stage several times a second
                self._told = feedback
                self._goal.publish_feedback(feedback)


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

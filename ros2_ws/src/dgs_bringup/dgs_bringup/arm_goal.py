"""A goal of one of the arm's actions under way, for a thread that does other things meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus

from dgs_bringup.ros_session import wait_until
from dgs_description.errors import DgsError, ErrorCode
from dgs_ros.action_client import SafeActionClient


class ArmGoal:
    """Sent when made; `result` must be asked for in the end.

    Attributes:
        stage: that feedback has told last.
        candidate: index among the goal's grasps that the arm has decided on; -1 = not yet.
        out_of_view: whether feedback has said that the robot is out of the camera's way and stays there.
    """

    def __init__(
        self, client: SafeActionClient, name: str, goal: Any, feedback: Callable[[str, str], None]
    ) -> None:
        """Send a goal to the action `name`; `feedback` gets every stage, and the name."""
        self.stage, self.candidate, self.out_of_view = "", -1, False
        self._client, self._name, self._feedback = client, name, feedback
        self._began = time.monotonic()
        self._result: Any = None
        self._handle: Any = None
        self._server, self._nobody = client.watch_server(), not client.server_is_ready()
        self._sent = client.send_goal_async(goal, feedback_callback=self._forward)
        self._sent.add_done_callback(self._accepted)

    def done(self) -> bool:
        """Whether the server has answered, or is gone."""
        ended = self._result is not None and self._result.done()
        refused = self._handle is not None and not self._handle.accepted
        return bool(ended or refused or self._gone())

    def _gone(self) -> bool:
        """Whether nobody was there to hear the goal, or who heard it has gone since."""
        return self._nobody or self._server.lost()

    def cancel(self) -> None:
        """Ask the arm to end the goal, also one that is still on its way there; returns at once."""
        self._client.cancel_when_accepted(self._sent)

    def result(self, asked_to_end: Callable[[], bool], answer_timeout: float, timeout: float) -> Any:
        """Wait for the result, also of a goal that is cancelled because it is asked to end.

        Args:
            answer_timeout: for accepting a goal, and for ending it when cancelled [s].
            timeout: for the whole goal, since it was sent [s].

        Returns:
            The action's result; None if the arm did not even accept it before it was to end.

        Raises:
            DgsError: TASK_ARM_UNAVAILABLE, TASK_ARM_FAILED.
        """
        wait_until(lambda: self._handle is not None or asked_to_end() or self._gone(), answer_timeout)
        if self._handle is None:
            self.cancel()
            if asked_to_end():
                return None
            silent = f"{self._name} did not answer; is the arm executor alive?"
            raise DgsError(ErrorCode.TASK_ARM_UNAVAILABLE, silent)
        if not self._handle.accepted:
            raise DgsError(ErrorCode.TASK_ARM_FAILED, "the arm executor refused the goal; see its log")
        left = self._began + timeout - time.monotonic()
        in_time = wait_until(lambda: self.done() or asked_to_end(), left)
        if not self._result.done() and not self._gone():
            # The arm brings its motion to an end and says so; wait for that, but not for ever.
            self.cancel()
            wait_until(lambda: self._result.done() or self._gone(), answer_timeout)
        if self._result.done() and self._result.result().status != GoalStatus.STATUS_UNKNOWN:
            answer = self._result.result().result
            if not in_time:
                answer.message = f"not done after {timeout:g} s: {answer.message}"
            return answer
        if asked_to_end():
            return None
        if self._gone():
            gone = "the arm executor went; the motion in work runs to its end, and the arm holds there"
            raise DgsError(ErrorCode.TASK_ARM_UNAVAILABLE, f"{self._name} gave no result: {gone}")
        took = time.monotonic() - self._began
        raise DgsError(ErrorCode.TASK_ARM_FAILED, f"{self._name} gave no result within {took:.0f} s")

    def _forward(self, message: Any) -> None:
        self.stage = message.feedback.stage
        self.candidate = getattr(message.feedback, "candidate", -1)
        self.out_of_view |= bool(getattr(message.feedback, "out_of_view", False))
        self._feedback(message.feedback.stage, self._name)

    def _accepted(self, sent: Any) -> None:
        handle = sent.result()
        if handle.accepted:
            self._result = handle.get_result_async()
        self._handle = handle

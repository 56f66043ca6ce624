"""An action client that may be used from any thread."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.action import ActionClient
from rclpy.qos import QoSProfile


class SafeActionClient(ActionClient):
    """An action client that may be used from any thread while another one spins its node.

    rclpy (Jazzy) writes down what it waits for only after the request is on its way. A server that answers at once is
    then "unexpected", its answer is dropped, and the goal runs on without anybody knowing. Here an answer waits until
    the request that is being sent is written down. Feedback is queued deep enough for a client that is held up: it may
    say only once that a stage has begun.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        self._sending = threading.RLock()
        super().__init__(*args, feedback_sub_qos_profile=QoSProfile(depth=100), **keywords)

    def send_goal_async(self, *args: Any, **keywords: Any) -> Any:
        """Send a goal, as `ActionClient.send_goal_async`."""
        with self._sending:
            return super().send_goal_async(*args, **keywords)

    @staticmethod
    def cancel_when_accepted(sent: Any) -> None:
        """Cancel the goal of a `send_goal_async` future as soon as it is accepted: nobody waits for it any more."""

        def cancel(accepted: Any) -> None:
            handle = accepted.result()
            if handle is not None and handle.accepted:
                handle.cancel_goal_async()

        sent.add_done_callback(cancel)

    def _get_result_async(self, goal_handle: Any) -> Any:
        with self._sending:
            return super()._get_result_async(goal_handle)

    def _cancel_goal_async(self, goal_handle: Any) -> Any:
        with self._sending:
            return super()._cancel_goal_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        """Hand out the answers that have come (called by the executor)."""
        with self._sending:
            pass
        await super().execute(taken_data)

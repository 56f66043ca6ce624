"""An action client that may be used from any thread."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.qos import QoSProfile
from unique_identifier_msgs.msg import UUID

from dgs_ros.presence import Watch, signed_goal_id, watch_server

ENDED = 4
"""Of so many goals that have ended feedback is still heard."""


class SafeActionClient(ActionClient):
    """An action client that may be used from any thread while another one spins its node.

    rclpy (Jazzy) writes down what it waits for only after the request is on its way. A server that answers at once is
    then "unexpected", its answer is dropped, and the goal runs on without anybody knowing. Here an answer waits until
    the request that is being sent is written down. Feedback is queued deep enough for a client that is held up, and
    heard also after the result, which rclpy takes first: it may say only once that a stage has begun. The goals are
    signed with the node's name: a server that asks `watch_client` learns that the client has died.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        self._sending = threading.RLock()
        self._ended: deque[bytes] = deque()
        super().__init__(*args, feedback_sub_qos_profile=QoSProfile(depth=100), **keywords)

    def send_goal_async(self, *args: Any, **keywords: Any) -> Any:
        """Send a goal, as `ActionClient.send_goal_async`."""
        with self._sending:
            return super().send_goal_async(*args, **keywords)

    def watch_server(self) -> Watch:
        """Says when the server that is there now has gone."""
        return watch_server(self._node, self._action_name)

    def cancel_all_async(self) -> Any:
        """Ask the server to end all goals, whoever has sent them; a future."""
        everything = ClientGoalHandle(self, UUID(), None)  # in the protocol, a goal without identity and time
        return self._cancel_goal_async(everything)

    def _generate_random_uuid(self) -> UUID:
        return signed_goal_id(self._node)

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

    def _remove_pending_result_request(self, future: Any) -> None:
        """Forget a request that is answered; rclpy forgets its goal's feedback, too, of which some may be queued."""
        told = dict(self._feedback_callbacks)
        super()._remove_pending_result_request(future)
        for goal in told.keys() - self._feedback_callbacks.keys():
            self._feedback_callbacks[goal] = told[goal]
            self._ended.append(goal)
            if len(self._ended) > ENDED:
                self._feedback_callbacks.pop(self._ended.popleft(), None)

    async def execute(self, taken_data: Any) -> None:
        """Hand out the answers that have come (called by the executor)."""
        with self._sending:
            pass
        await super().execute(taken_data)

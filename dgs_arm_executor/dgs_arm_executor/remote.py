"""Action and service servers from a worker thread: send, wait with interruptions, cancel. Imports no ROS."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from dgs_description.errors import DgsError, ErrorCode

_POLL = 0.02
_SERVICE_TIMEOUT = 2.0
_ANSWER_TIMEOUT = 5.0
_CANCEL_TIMEOUT = 10.0
_GRACE = 0.5
"""A server that is missing for so long has gone; on a busy machine discovery may lose one for a moment.

All in wall time [s].
"""


class RemoteGoal:
    """Sends goals through one action client, one at a time; `cancel` may come from any thread."""

    def __init__(self, client: Any, name: str, refused: ErrorCode, gone: ErrorCode):
        """Take a `SafeActionClient` that is spun elsewhere.

        Args:
            refused, gone: codes of a server that refuses or does not answer, and of one that is not there any more.
        """
        self._client, self._name, self._refused, self._gone = client, name, refused, gone
        self._lock = threading.Lock()
        self._handle: Any = None
        self._cleared: Any = None
        self._asked, self._seen = -math.inf, -math.inf

    def available(self) -> bool:
        """Whether the server is there, and has ended what a client before this one may have left.

        A server that has only just come may lose the answer: after a while it is asked again.
        """
        ready, now = self._there(), time.monotonic()
        with self._lock:
            if not ready:
                self._cleared = None
                return False
            if self._cleared is None or (not self._cleared.done() and now - self._asked > _SERVICE_TIMEOUT):
                self._cleared, self._asked = self._client.cancel_all_async(), now
            return bool(self._cleared.done())

    def check(self) -> None:
        """Raise DgsError `gone` if nobody serves any more."""
        if not self._there():
            raise DgsError(self._gone, f"{self._name} has gone")

    def run(self, goal: Any, watch: Callable[[], None], feedback: Callable[[Any], None] | None = None) -> Any:
        """Send a goal and wait for its end; return what rclpy gives (`.status`, `.result`).

        `watch` is called before the goal is sent, when it is accepted, and every 20 ms; what it raises cancels the goal
        and is passed on.

        Raises:
            DgsError: no answer, the goal was rejected, or the server has gone.
        """
        self.check()
        watch()
        server = self._client.watch_server()
        sent = self._client.send_goal_async(goal, feedback_callback=feedback)

        def look() -> None:
            watch()
            if server.lost():
                raise DgsError(self._gone, f"{self._name} went while it had a goal")

        try:
            _wait(sent, look, _ANSWER_TIMEOUT)
            handle = sent.result()
            if not handle.accepted:
                raise DgsError(self._refused, f"{self._name} rejected the goal")
            with self._lock:
                self._handle = handle
            watch()  # a stop that came while the goal was under way found nothing to cancel
            result = handle.get_result_async()
            _wait(result, look, None)
            return result.result()
        except TimeoutError as error:
            self._client.cancel_when_accepted(sent)
            raise DgsError(self._refused, f"{self._name}: {error}") from error
        except Exception:
            self._end(sent, server)
            raise
        finally:
            with self._lock:
                self._handle = None

    def cancel(self) -> None:
        """Ask the server to end the running goal, if any; returns at once."""
        with self._lock:
            handle = self._handle
        if handle is not None:
            handle.cancel_goal_async()

    def _there(self) -> bool:
        now = time.monotonic()
        if self._client.server_is_ready():
            self._seen = now
        return now - self._seen <= _GRACE

    def _end(self, sent: Any, server: Any) -> None:
        """Cancel a goal and wait until the server has ended it, or has gone.

        Whoever asked for the stop wants to hear of it when the robot stands, and the next goal must not find it busy.
        """

        def look() -> None:
            if server.lost():
                raise TimeoutError

        try:
            _wait(sent, look, _CANCEL_TIMEOUT)
            handle = sent.result()
            if handle.accepted:
                handle.cancel_goal_async()
                _wait(handle.get_result_async(), look, _CANCEL_TIMEOUT)
        except TimeoutError:
            self._client.cancel_when_accepted(sent)


def call_service(client: Any, request: Any, code: ErrorCode) -> Any:
    """The response to a request to a service whose client is spun elsewhere. Raises DgsError `code` without one.

    A server that was started again may have met the client's question before the way back to it: its answer is lost
    then. So it is asked a second time, and must not mind.
    """
    for _ in range(2):
        future = client.call_async(request)
        try:
            _wait(future, lambda: None, _SERVICE_TIMEOUT)
            return future.result()
        except TimeoutError:
            client.remove_pending_request(future)
    raise DgsError(code, f"{client.srv_name}: no answer within {2 * _SERVICE_TIMEOUT:g} s")


def _wait(future: Any, watch: Callable[[], None], timeout: float | None) -> None:
    """Raises TimeoutError."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    end = None if timeout is None else time.monotonic() + timeout
    while not done.wait(_POLL):
        watch()
        if end is not None and time.monotonic() > end:
            raise TimeoutError(f"no answer within {timeout:g} s")

"""An action server that says how many of its goals have no result yet, and whose answers are not given up."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.action import ActionServer
from rclpy.action.server import _rclpy

from dgs_ros.answers import patiently

RESULT_KEPT = 30.0
"""How long a result can be asked for after a goal's end [s]; rclpy's 900 s let memory grow for a quarter of an hour."""
ANSWERS = ("send_goal_response", "send_cancel_response", "send_result_response")


def patient(handle: type) -> type:
    """A class of handles, through which rclpy's action servers answer, that sends again what is given up."""
    return type("PatientHandle", (handle,), {name: patiently(getattr(handle, name)) for name in ANSWERS})


# rclpy makes its handles itself, by this name: a class put there is the one place that all answers pass.
_rclpy.ActionServer = patient(_rclpy.ActionServer)


class CountingActionServer(ActionServer):
    """An action server whose node can wait, when it ends, until all clients have their results.

    Answers are sent again where the middleware gives them up (`dgs_ros.answers`).
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        self._count = threading.Lock()
        self._unfinished = 0
        super().__init__(*args, result_timeout=RESULT_KEPT, **keywords)

    @property
    def unfinished(self) -> int:
        """Goals that were accepted and whose result is not sent yet."""
        return self._unfinished

    async def _execute_goal(self, *args: Any) -> None:
        with self._count:
            self._unfinished += 1
        try:
            await super()._execute_goal(*args)
        finally:
            with self._count:
                self._unfinished -= 1

"""An action server that says how many of its goals have no result yet."""

from __future__ import annotations

import threading
from typing import Any

from rclpy.action import ActionServer


class CountingActionServer(ActionServer):
    """An action server whose node can wait, when it ends, until all clients have their results."""

    def __init__(self, *args: Any, **keywords: Any) -> None:
        self._count = threading.Lock()
        self._unfinished = 0
        super().__init__(*args, **keywords)

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

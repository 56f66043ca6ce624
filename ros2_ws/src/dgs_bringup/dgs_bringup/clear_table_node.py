"""Serves the /clear_table action, one run at a time."""

from __future__ import annotations

import threading
import traceback
from typing import Any

from dgs_interfaces.action import ClearTable
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup

from dgs_bringup.clear_table import ClearTableParameters
from dgs_bringup.clear_table_run import ClearTableRun, Partners
from dgs_description.errors import DgsError, ErrorCode
from dgs_ros.action_client import SafeActionClient
from dgs_ros.base_node import DgsNode, end_goal
from dgs_ros.diagnostics import Level
from dgs_ros.run import run


class ClearTableNode(DgsNode[ClearTableParameters]):
    """Serves /clear_table; with `autostart` it is its first client."""

    def __init__(self, **node_arguments: Any) -> None:
        """Create the server and the clients of planner and arm."""
        super().__init__("clear_table", ClearTableParameters, **node_arguments)
        group = ReentrantCallbackGroup()
        self._busy = threading.Lock()
        self._partners = Partners(self, group)
        self.serve_action(ClearTable, "/clear_table", self._execute)
        self.report(Level.OK, "idle")
        if self.parameters.autostart:
            self._own = SafeActionClient(self, ClearTable, "/clear_table", callback_group=group)
            self._autostart = self.create_timer(0.5, self._start_by_itself, callback_group=group)

    def _execute(self, goal: ServerGoalHandle) -> ClearTable.Result:
        clearing = ClearTableRun(self, self._partners, goal)
        code, message = self._clear(clearing)
        end_goal(goal, code == ErrorCode.SUCCESS, cancelled=True)
        if code != ErrorCode.TASK_BUSY:
            expected = code in (ErrorCode.SUCCESS, ErrorCode.TASK_CANCELLED)
            self.report(Level.OK if expected else Level.WARN, message, code=int(code))
        self.get_logger().info(f"run ended ({int(code)}): {message}")
        return clearing.result(code, message)

    def _clear(self, clearing: ClearTableRun) -> tuple[ErrorCode, str]:
        """How the run ends."""
        if not self._busy.acquire(blocking=False):
            return ErrorCode.TASK_BUSY, "another run is going on"
        try:
            end = clearing.clear()
            return end.code, end.message
        except DgsError as error:
            return error.code, error.message
        except Exception as error:  # the client must get its answer whatever happened
            self.get_logger().error(f"the run broke off\n{traceback.format_exc()}")
            return ErrorCode.NODE_INTERNAL, f"unexpected {type(error).__name__}, see the node's log: {error}"
        finally:
            self._busy.release()

    def _start_by_itself(self) -> None:
        if self._partners.there() and self._own.server_is_ready():
            self._autostart.cancel()
            self._own.send_goal_async(ClearTable.Goal(seed=self.parameters.seed))


def main(args: list[str] | None = None) -> None:
    """Entry point of the executable `clear_table`."""
    run(ClearTableNode, args)

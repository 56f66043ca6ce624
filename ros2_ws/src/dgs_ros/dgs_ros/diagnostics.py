"""The diagnostic statuses of one node, by component."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

EVENT_LASTS = 5.0
"""A single event, whose end nobody reports, is over after so long unless it comes again [s of wall time]."""


class Level(IntEnum):
    """Levels of a diagnostic status."""

    OK = 0
    WARN = 1
    ERROR = 2


class StatusBoard:
    """Newest status of every component; any thread may write and read."""

    def __init__(self, node: str) -> None:
        """Nothing is known yet of `node`, whose full name starts every status."""
        self._node = node
        self._lock = threading.Lock()
        self._statuses: dict[str, DiagnosticStatus] = {}
        self._expiry: dict[str, float] = {}

    def put(
        self, level: Level, message: str, component: str, lasts: float, values: Mapping[str, object]
    ) -> bool:
        """Replace the status of a component, which is over after `lasts` [s]; whether its level is new."""
        status = DiagnosticStatus(
            level=bytes([Level(level)]),
            name=f"{self._node}{': ' if component else ''}{component}",
            message=message,
            hardware_id=self._node.rpartition("/")[2],
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        with self._lock:
            before = self._statuses.get(component)
            self._statuses[component] = status
            self._expiry[component] = time.monotonic() + lasts
        return before is None or before.level != status.level

    def statuses(self) -> list[DiagnosticStatus]:
        """One status per component; those that are over are OK."""
        now = time.monotonic()
        with self._lock:
            for component, status in self._statuses.items():
                if self._expiry[component] < now and status.level != bytes([Level.OK]):
                    over = DiagnosticStatus(name=status.name, hardware_id=status.hardware_id)
                    over.message = f"not reported any more; the last was: {status.message}"
                    self._statuses[component] = over
            return list(self._statuses.values())

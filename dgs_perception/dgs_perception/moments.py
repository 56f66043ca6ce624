"""Puts together what several topics publish of the same moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

KEPT = 4
"""Unfinished moments that are remembered: one topic may be so many messages behind another."""


class Moments:
    """Messages by stamp, until all topics of a moment are there. For one thread at a time."""

    def __init__(self, names: Sequence[str]) -> None:
        """`names`: of the topics that a whole moment has."""
        self._names = frozenset(names)
        self._started: dict[int, dict[str, Any]] = {}

    def add(self, name: str, stamp_ns: int, message: Any) -> dict[str, Any] | None:
        """The whole moment by name, once the last message of its stamp [ns] has come; older ones are forgotten."""
        moment = self._started.setdefault(stamp_ns, {})
        moment[name] = message
        if self._names <= moment.keys():
            self._started = {stamp: m for stamp, m in self._started.items() if stamp > stamp_ns}
            return moment
        while len(self._started) > KEPT:
            del self._started[next(iter(self._started))]  # the first that came: stamps may jump back
        return None

"""Whether the hand presses on something: the bound that ends straight ways near the table. No ROS."""

from __future__ import annotations

import threading

import numpy as np

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array

LASTING = 0.02
"""A force above the bound for so long is no blow of the contact itself, or noise [s]."""
MAX_FORCE = 50.0
"""[N]; what the robot presses on the table with otherwise stands in docs/evaluation.md, robot protocol."""


class ForceGuard:
    """The newest force on the hand against that of a hand that hangs free; without measurements it allows all."""

    def __init__(self, limit: float = MAX_FORCE):
        """`limit`: bound of the force [N], 0 = none."""
        self._limit = limit
        self._force, self._free = np.zeros(3), np.zeros(3)
        self._since: float | None = None
        self._exceeded = 0.0
        self._pushed_off = False
        self._lock = threading.Lock()

    def measured(self, force: Array, stamp: float) -> None:
        """The wrist feels a force (3,) [N], in `tool0`, at a time [s]."""
        with self._lock:
            self._force = force
            size = float(np.linalg.norm(force - self._free))
            if not 0.0 < self._limit < size:
                self._since = None
                return
            if self._since is None or stamp < self._since:
                self._since = stamp
            if stamp - self._since >= LASTING:
                self._exceeded = max(self._exceeded, size)

    def pushed_off(self) -> None:
        """The controller says that the arm has left its path: something presses, whatever the wrist has told so far."""
        self._pushed_off = self._limit > 0.0

    def tare(self) -> None:
        """The hand hangs free now: forces count from here, and what was is forgotten."""
        self.forget()
        with self._lock:
            self._free = self._force

    def forget(self) -> None:
        """What was, is dealt with."""
        with self._lock:
            self._since, self._exceeded, self._pushed_off = None, 0.0, False

    @property
    def eased(self) -> bool:
        """Whether the hand presses with less than half the bound now."""
        return float(np.linalg.norm(self._force - self._free)) < self._limit / 2

    def check(self) -> None:
        """Raise DgsError FORCE_LIMIT if the bound was exceeded and nobody has dealt with it."""
        if self._exceeded:
            met = f"the hand meets something with {self._exceeded:.0f} N"
            raise DgsError(ErrorCode.FORCE_LIMIT, f"{met}, {self._limit:g} N are allowed")
        if self._pushed_off:
            raise DgsError(
                ErrorCode.FORCE_LIMIT, "the hand meets something that has pushed the arm off its path"
            )

"""State of the hand, put together from its CAN frames cycle by cycle."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array
from dgs_hand_driver.can_protocol import (
    CLOCK_RANGE,
    FingerFrame,
    Mode,
    StatusFrame,
    expand_positions,
    expand_torques,
)

MAX_STEP = 60.0
"""A longer step of the clock is a restart [s]."""


@dataclass(frozen=True)
class HandState:
    """One complete cycle."""

    positions: Array
    """(20,) measured joints [rad]"""
    torques: Array
    """(20,) drive torques, positive in closing direction; the coupled pair's stands at joint3 [Nm]"""
    mode: Mode
    accepted: int
    """sequence (0..255) of the newest command that the hand has taken"""
    clock: float
    """time of the hand since the first cycle, never going back [s]"""
    received: float
    """`time.monotonic()` at arrival [s]"""
    cycle: int
    """counts the complete cycles"""


class StateAssembler:
    """Collects the frames of a cycle; a cycle with a lost or damaged frame is dropped and counted."""

    def __init__(self, yaw_signs: ArrayLike = 1.0) -> None:
        """`yaw_signs`: (5,) +1 or -1, direction of the measured yaw of every finger on this hand."""
        self._signs = np.ones((5, 3))
        self._signs[:, 0] = yaw_signs
        self._frames: dict[tuple[str, int], FingerFrame] = {}
        self._last_clock: float | None = None
        self._clock = 0.0
        self._cycle = 0
        self.incomplete = 0
        """Cycles dropped."""

    def add(self, frame: FingerFrame | StatusFrame) -> HandState | None:
        """Take a frame; the status frame that closes a complete cycle gives the state."""
        if isinstance(frame, FingerFrame):
            self._frames[frame.kind, frame.finger] = frame
            return None
        rows = {}
        for kind in ("position", "torque"):
            frames = [self._frames.get((kind, finger)) for finger in range(5)]
            rows[kind] = [f.values for f in frames if f is not None and f.sequence == frame.sequence]
            if len(rows[kind]) < 5:
                self.incomplete += 1
                return None
        self._advance(frame.clock)
        self._cycle += 1
        return HandState(
            positions=expand_positions(np.array(rows["position"]) * self._signs),
            torques=expand_torques(np.array(rows["torque"]) * self._signs),
            mode=frame.mode,
            accepted=frame.accepted,
            clock=self._clock,
            received=time.monotonic(),
            cycle=self._cycle,
        )

    def _advance(self, clock: float) -> None:
        # The clock wraps after 50 days and starts anew with the hand or the simulator: durations must not jump then.
        if self._last_clock is not None:
            step = (clock - self._last_clock) % CLOCK_RANGE
            if step < MAX_STEP:
                self._clock += step
        self._last_clock = clock

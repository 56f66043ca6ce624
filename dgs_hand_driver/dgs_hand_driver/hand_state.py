"""What the driver tells a hand, and what the hand says of itself, whatever protocol carries it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.hand import HAND

Mode = Literal["position", "admittance", "hold"]

STATE_PERIOD = 0.01
"""The hand's cycle: time between two states [s]."""


@dataclass(frozen=True)
class HandCommand:
    """What the hand is to do.

    In mode "position" the joints go to `target` at `speed`; in mode "admittance" the fingers of `active` comply
    (`AdmittanceController`); in mode "hold" they stay stiffly at `target`, which is where they were measured.
    """

    mode: Mode = "position"
    target: Array = field(default_factory=lambda: HAND.straight)
    """(J,) within the limits, coupled joints together [rad]"""
    speed: float = HAND.speed
    """limit of every joint [rad/s]"""
    active: NDArray[np.bool_] = field(default_factory=lambda: np.ones(HAND.finger_count, dtype=bool))
    """(F,) fingers that comply in admittance mode"""
    sequence: int = 0
    """changes with every new command"""


@dataclass(frozen=True)
class HandState:
    """One complete cycle."""

    positions: Array
    """(J,) measured joints [rad]"""
    torques: Array
    """(J,) drive torques, positive in closing direction; a drive's stands at the joint that it drives [Nm]"""
    mode: Mode
    accepted: int
    """sequence (0..255) of the newest command that the hand has taken"""
    clock: float
    """time of the hand since the first cycle, never going back [s]"""
    received: float
    """`time.monotonic()` at arrival [s]"""
    cycle: int
    """counts the complete cycles"""
    forces: Array | None = None
    """(F, 2) normal and tangential force on the fingertips [N], NaN where a sensor says nothing; None: no sensors"""

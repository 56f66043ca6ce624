"""Faults of the simulated hardware: which there are, which are on, and until when. No ROS."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import HAND

CLEAR = "clear"
FAULTS = (
    "freeze_camera", "drop_joint_states", "protective_stop", "emergency_stop", "jam_finger", "abort_arm_goal", CLEAR,
)  # fmt: skip


class Faults:
    """The faults that are on.

    freeze_camera: no pictures. drop_joint_states: the arm's `/joint_states` are silent, and with them the wrench, which
    comes the same way. protective_stop: the robot's program pauses as on the real robot: speed scaling is 0, the
    running goal stands still, and goes on afterwards unless somebody cancels it. emergency_stop: the program ends, the
    running goal aborts, new ones are refused. jam_finger: a finger is stuck. abort_arm_goal: the running goal aborts,
    or the next one if none runs; with a duration every goal within it.
    """

    def __init__(self) -> None:
        self._until: dict[tuple[str, str], float] = {}

    @staticmethod
    def check(fault: str, target: str, duration: float) -> None:
        """Look at a request before it is taken.

        Raises:
            DgsError: unknown fault or finger, or a duration that is negative or not finite.
        """
        if fault not in FAULTS:
            unknown = f"there is no fault {fault!r}; known are {', '.join(FAULTS)}"
            raise DgsError(ErrorCode.SIM_FAULT_UNKNOWN, unknown)
        if fault == "jam_finger" and target not in HAND.fingers:
            wrong = f"jam_finger needs a finger as target ({', '.join(HAND.fingers)}), got {target!r}"
            raise DgsError(ErrorCode.SIM_REQUEST, wrong)
        if not (np.isfinite(duration) and duration >= 0):
            raise DgsError(ErrorCode.SIM_REQUEST, f"a duration must be a number >= 0 s, got {duration!r}")

    def inject(self, fault: str, target: str, duration: float, now: float) -> None:
        """Switch a checked fault on for `duration` seconds (0 = until `clear`), or all off by "clear"."""
        if fault == CLEAR:
            self._until = {}
        else:
            until = now + duration if duration > 0 else np.inf
            self._until = {
                **self._until,
                (fault, target): until,
            }  # other threads may be looking at the old one

    def expire(self, now: float) -> None:
        """Switch off what has had its time."""
        self._until = {key: until for key, until in self._until.items() if until > now}

    def on(self, fault: str) -> bool:
        """Whether a fault is on, whatever its target."""
        return any(name == fault for name, _ in self._until)

    def take(self, fault: str) -> bool:
        """Whether a fault is on; one without a duration goes off by that."""
        if not self.on(fault):
            return False
        self._until = {k: until for k, until in self._until.items() if k[0] != fault or np.isfinite(until)}
        return True

    @property
    def jammed(self) -> NDArray[np.bool_]:
        """(F,) fingers that are stuck."""
        return np.array([("jam_finger", finger) in self._until for finger in HAND.fingers])

    @property
    def names(self) -> list[str]:
        """The faults that are on, with their targets."""
        return sorted(f"{fault} {target}".strip() for fault, target in self._until)

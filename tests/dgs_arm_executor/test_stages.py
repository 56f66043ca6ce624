"""What a hand that was ended while it opened has done with the object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import pytest

from dgs_arm_executor.stages import Robot, has_let_go
from dgs_arm_executor.watch import HandReading
from dgs_description.errors import DgsError, ErrorCode

CLOSED = np.tile([0.0, 0.5, 0.4, 0.4], 5)
PRESSING, LIMP, PUSHING_OPEN = np.full(20, 0.3), np.zeros(20), np.full(20, -0.6)
STOPPED = DgsError(ErrorCode.STOPPED, "stopped")
JAMMED = DgsError(ErrorCode.HAND_BLOCKED, "jammed")


@dataclass
class Hand:
    """The state in which a hand comes to rest; None = it sends nothing any more."""

    reading: HandReading | None

    def hand_at_rest(self) -> HandReading:
        if self.reading is None:
            raise DgsError(ErrorCode.HAND_UNAVAILABLE, "silent")
        return self.reading


@pytest.mark.parametrize(
    ("joints", "torques", "error", "free"),
    [
        (CLOSED, PRESSING, STOPPED, False),
        (CLOSED, LIMP, STOPPED, True),
        (np.zeros(20), LIMP, STOPPED, True),
        (np.zeros(20), LIMP, JAMMED, True),
        (CLOSED, PUSHING_OPEN, JAMMED, False),
        (CLOSED, LIMP, JAMMED, False),
    ],
    ids=["holds", "dropped out", "opened", "one jammed", "all jammed", "all jammed, drives off"],
)
def test_what_the_hand_did(joints: np.ndarray, torques: np.ndarray, error: DgsError, free: bool) -> None:
    before = HandReading(CLOSED, PRESSING, 0)
    robot = cast(Robot, Hand(HandReading(joints, torques, 1)))
    assert has_let_go(robot, before, error) is free


def test_a_silent_hand_is_not_believed_to_have_let_go() -> None:
    assert not has_let_go(cast(Robot, Hand(None)), HandReading(CLOSED, PRESSING, 0), STOPPED)

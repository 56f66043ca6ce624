"""Who drives the robot: one goal at a time, and one that gets ready behind a goal that is on its last way."""

from __future__ import annotations

import threading

from dgs_arm_executor.situation import ArmSituation
from dgs_description.errors import DgsError, ErrorCode


class Turns:
    """Thread-safe; every goal has a thread of its own.

    A goal that is on its last way says with `offer` how it will leave the robot. Behind it one other goal may `follow`:
    it plans from there while the first one still moves, and drives as soon as that has kept its word.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._driving = self._following = self._kept = False
        self._left: ArmSituation | None = None

    def take(self) -> bool:
        """Drive from now on; False where another goal does or is next."""
        with self._changed:
            if self._driving or self._following:
                return False
            self._driving = True
            return True

    def offer(self, left: ArmSituation) -> None:
        """The driving goal will end with an empty hand, and arm and hand so."""
        with self._changed:
            self._left = left

    def follow(self) -> ArmSituation | None:
        """Be the next: how the driving goal will leave the robot; None where there is nothing to follow."""
        with self._changed:
            if self._left is None or self._following:
                return None
            self._following = True
            return self._left

    def succeed(self, timeout: float) -> bool:
        """As follower, drive from now on, once the driving goal has ended; False where it has not within `timeout` [s].

        Raises:
            DgsError: SCENE_CHANGED if it ended otherwise than it had offered.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self._driving, timeout):
                return False
            if not self._kept:
                before = "the goal before did not end as it had offered"
                raise DgsError(ErrorCode.SCENE_CHANGED, f"{before}: look at the table again")
            self._following, self._driving, self._left = False, True, None
            return True

    def leave(self) -> None:
        """As follower, give up."""
        with self._changed:
            self._following = False

    def end(self, kept: bool) -> None:
        """As driving goal, end; `kept`: as offered."""
        with self._changed:
            self._driving, self._left, self._kept = False, None, kept
            self._changed.notify_all()

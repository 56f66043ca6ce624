"""Who drives the robot: one goal at a time, and one that gets ready behind a goal that carries its object away."""

from __future__ import annotations

import threading

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array


class Turns:
    """Thread-safe; every goal has a thread of its own.

    A goal that will leave the arm over the bin says so with `offer`. Behind it one other goal may `follow`: it plans
    from there while the first one still moves, and drives as soon as that has kept its word.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._driving = self._following = self._kept = False
        self._posture: Array | None = None

    def take(self) -> bool:
        """Drive from now on; False where another goal does or is next."""
        with self._changed:
            if self._driving or self._following:
                return False
            self._driving, self._posture = True, None
            return True

    def offer(self, posture: Array) -> None:
        """The driving goal will end with an open, empty hand and the arm at (6,) joints [rad]."""
        with self._changed:
            self._posture = posture

    def follow(self) -> Array | None:
        """Be the next: (6,) joints where the driving goal will leave the arm; None where there is nothing to follow."""
        with self._changed:
            if self._posture is None or self._following:
                return None
            self._following = True
            return self._posture

    def succeed(self, timeout: float) -> bool:
        """As follower, drive from now on, once the driving goal has ended; False where it has not within `timeout` [s].

        Raises:
            DgsError: SCENE_CHANGED if it ended otherwise than it had offered.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: not self._driving, timeout):
                return False
            if not self._kept:
                before = "the goal before did not end over the bin with an empty hand"
                raise DgsError(ErrorCode.SCENE_CHANGED, f"{before}: look at the table again")
            self._following, self._driving, self._posture = False, True, None
            return True

    def leave(self) -> None:
        """As follower, give up."""
        with self._changed:
            self._following = False

    def end(self, kept: bool) -> None:
        """As driving goal, end; `kept`: as offered."""
        with self._changed:
            self._driving, self._posture, self._kept = False, None, kept
            self._changed.notify_all()

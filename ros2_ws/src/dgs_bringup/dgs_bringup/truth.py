"""What really happened to the objects, from the simulator's ground truth; for summaries only. No ROS."""

from __future__ import annotations

from collections.abc import Sequence

BIN, HELD = "bin", "held"
HOLD_TIME = 0.5
"""An object counts as lifted once it was held at least 0.1 m above the table for so long, and as lying there again
once it was neither held nor in the bin for so long: it may just be falling into it [s of simulated time]."""


class TruthTracker:
    """Follows the places of all objects through a run.

    Attributes:
        time: simulated time of the newest state [s].
        places: last known place of every object.
    """

    def __init__(self) -> None:
        self.time = 0.0
        self.places: dict[str, str] = {}
        self._held_since: dict[str, float] = {}
        self._down_since: dict[str, float] = {}
        self._lifted: set[str] = set()
        self._credited: set[str] = set()
        """Objects that an attempt has got already: they may still be held, or come into the bin only now."""

    def update(self, time: float, names: Sequence[str], places: Sequence[str]) -> None:
        """Take in a state of the world at a simulated time [s]."""
        self.time = time
        self.places = dict(zip(names, places, strict=True))
        for name, place in self.places.items():
            if place in (HELD, BIN):
                down = time - self._down_since.pop(name, time)
            else:
                down = time - self._down_since.setdefault(name, time)
            if down >= HOLD_TIME:
                self._credited.discard(name)
            if place == HELD:
                held = time - self._held_since.setdefault(name, time)
                if held >= HOLD_TIME and name not in self._credited:
                    self._lifted.add(name)
            else:
                self._held_since.pop(name, None)

    def end_attempt(self) -> bool:
        """True if an object was lifted and held, or came into the bin, since the last attempt ended.

        An object that an attempt leaves in the hand counts for that attempt, wherever it goes later.
        """
        gained = self._lifted | {name for name, place in self.places.items() if place == BIN}
        success = bool(gained - self._credited)
        self._credited |= gained
        self._lifted.clear()
        return success

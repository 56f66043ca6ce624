"""What really happened to the objects, from the simulator's ground truth; for summaries only. No ROS."""

from __future__ import annotations

from collections.abc import Sequence

BIN, HELD = "bin", "held"
HOLD_TIME = 0.5
"""An object counts as lifted once it was held at least 0.1 m above the table for so long [s of simulated time]."""


class TruthTracker:
    """Follows the places of all objects through a run.

    Attributes:
        time: simulated time of the newest state [s].
    """

    def __init__(self, hold_time: float = HOLD_TIME) -> None:
        """Nothing has been seen yet."""
        self.time = 0.0
        self._hold_time = hold_time
        self._places: dict[str, str] = {}
        self._held_since: dict[str, float] = {}
        self._lifted: set[str] = set()
        self._counted: set[str] = set()

    def update(self, time: float, names: Sequence[str], places: Sequence[str]) -> None:
        """Take in a state of the world at a simulated time [s]."""
        self.time = time
        self._places = dict(zip(names, places, strict=True))
        for name, place in self._places.items():
            if place != HELD:
                self._held_since.pop(name, None)
            elif time - self._held_since.setdefault(name, time) >= self._hold_time:
                self._lifted.add(name)

    def end_attempt(self) -> bool:
        """True if an object was lifted and held, or came into the bin, since the last attempt ended."""
        in_bin = {name for name, place in self._places.items() if place == BIN}
        success = bool(self._lifted or in_bin - self._counted)
        self._counted |= in_bin
        self._lifted.clear()
        return success

    @property
    def objects(self) -> int:
        """Number of objects of the scene."""
        return len(self._places)

    @property
    def cleared(self) -> int:
        """Number of objects that are in the bin now."""
        return sum(place == BIN for place in self._places.values())

    @property
    def places(self) -> dict[str, str]:
        """Last known place of every object."""
        return dict(self._places)

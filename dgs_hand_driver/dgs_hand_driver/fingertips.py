"""What the forces on the fingertips tell: contact, and slip."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.hand import HAND

Flags = NDArray[np.bool_]

# [own] Chosen in the simulator.
CONTACT_FORCE = 0.3
"""A larger normal force is contact [N]."""
SLIP_RISE = 0.2
"""An object slips that draws along the fingertip by so much more, in shares of the normal force, ..."""
SLIP_TIME = 0.2
"""... than within this time before [s]."""


def in_contact(forces: Array, contact_force: float = CONTACT_FORCE) -> Flags:
    """(F,) fingertips that touch, of (F, 2) normal and tangential forces [N]; NaN touches nothing."""
    return np.asarray(forces[:, 0] > contact_force)


class SlipWatch:
    """Tells slip by the tangential share of the force.

    Coulomb: an object sticks while the share is below the coefficient of friction. That is not known, but a share that
    rises in a grip that stands is on its way there.
    """

    def __init__(self, contact_force: float = CONTACT_FORCE) -> None:
        """A normal force above `contact_force` is contact [N]."""
        self._contact_force = contact_force
        self._window: deque[tuple[float, Array]] = deque()

    def update(self, clock: float, forces: Array) -> Flags:
        """(F,) fingertips that slip, of (F, 2) forces [N] at the hand's time `clock` [s].

        Only a fingertip that has been in contact for the whole `SLIP_TIME` can.
        """
        if self._window and clock < self._window[-1][0]:  # another connection
            self._window.clear()
        touches = in_contact(forces, self._contact_force)
        share = np.full(HAND.finger_count, np.nan)
        share[touches] = forces[touches, 1] / forces[touches, 0]
        self._window.append((clock, share))
        while len(self._window) > 1 and self._window[1][0] <= clock - SLIP_TIME:
            self._window.popleft()
        if clock - self._window[0][0] < SLIP_TIME:
            return np.zeros(HAND.finger_count, dtype=bool)
        shares = np.array([share for _, share in self._window])
        return np.asarray(share - shares.min(axis=0) > SLIP_RISE)  # NaN, no contact, is never larger

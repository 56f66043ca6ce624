"""Facts of a pick that hand driver, arm executor, simulator and evaluation share."""

from __future__ import annotations

import numpy as np

from dgs_description.hand_model import YAW_SPREAD

OPEN_HAND = np.stack([YAW_SPREAD, *np.zeros((3, 5))], axis=1).reshape(20)
"""(20,) straight fingers, fanned out so that neighbours do not touch and what sticks between them falls out [rad]."""
STAND_OFF = 0.10
"""The straight approach starts so far back along the TCP's z [m] (section V of the paper)."""
LIFT = 0.15
"""Straight up with the object [m]."""
CLOSING_MARGIN = (0.0, 0.20, 0.14)
"""Added to the final yaw, pitch and middle joint of every finger that closes: J_end is where contact was [rad]."""

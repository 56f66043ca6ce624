"""How the driver treats a hand: the parameters of the node that are the hand's."""

from __future__ import annotations

from dataclasses import dataclass

from dgs_description.hand import HAND
from dgs_description.parameters import parameter
from dgs_hand_driver.fingertips import CONTACT_FORCE
from dgs_hand_driver.move_monitor import BLOCKED_TORQUE, CONTACT_TORQUE, Triple


@dataclass(frozen=True)
class HandSettings:
    """How the driver treats the hand. Signs are of every finger; triples yaw, pitch, middle (with distal)."""

    # A simulator that renders makes pauses.
    silence_timeout: float = parameter(5.0, "Wall time without joint states [s].", 0.1, 60.0)
    bus_timeout: float = 3.0
    """wall time without any frame, 30 heartbeats, after which the connection counts as lost [s]"""
    # Some hands command and measure yaw in opposite directions.
    yaw_command_signs: tuple[float, ...] = parameter(
        (1.0,) * HAND.finger_count,
        "Direction of the commanded yaw of every finger on this hand.",
        choices=(1.0, -1.0),
    )
    yaw_state_signs: tuple[float, ...] = parameter(
        (1.0,) * HAND.finger_count,
        "Direction of the measured yaw of every finger on this hand.",
        choices=(1.0, -1.0),
    )
    blocked_torque: Triple = parameter(BLOCKED_TORQUE, "Unexpected contact in position mode [Nm].", 0.01, 5.0)
    contact_torque: Triple = parameter(
        CONTACT_TORQUE, "Contact of a closing finger; yaw says nothing [Nm].", 0.01, 5.0
    )
    contact_force: float = parameter(
        CONTACT_FORCE, "Contact of a fingertip that feels forces [N].", 0.01, 10.0
    )
    dbc: str = parameter("", "Of the DBC protocol: database to use in place of the package's; empty = own.")

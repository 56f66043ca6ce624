"""The seam between driver and wire: what a hand's protocol must offer, and which one the hand's folder names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from importlib import import_module
from typing import ClassVar

import can

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_description.hand_model import HandModel
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand, HandState

NO_FINGER = (False,) * HAND.finger_count


class HandFirmware(ABC):
    """The hand's end of the wire, for the simulator and for tests; the joints are the caller's. One thread at a time.

    Attributes:
        command: the newest complete one; `sequence` counts them.
    """

    def __init__(self) -> None:
        self.command = HandCommand()

    @abstractmethod
    def receive(self, message: can.Message) -> list[can.Message]:
        """Take a frame from the driver; the frames that answer it."""

    @abstractmethod
    def state(self, positions: Array, torques: Array, forces: Array, clock: float) -> list[can.Message]:
        """Frames of one cycle: (J,) joints [rad], (J,) torques [Nm], (F, 2) fingertip forces [N], time [s]."""

    @abstractmethod
    def inject(self, fault: str, fingers: Sequence[bool]) -> list[can.Message]:
        """Frames that report a fault from now on, "none" ends it. Raises ValueError: unknown fault."""

    def beat(self, uptime: float) -> list[can.Message]:
        """Frames that go out every 0.1 s of wall time, whatever the joints do [s]."""
        return []


class HandProtocol(ABC):
    """The driver's end of the wire; one object per connection, fresh when the bus has been opened again.

    `receive` and `follow_up` are called by the thread that reads, `command` and `clear_fault` by the one that moves.

    Attributes:
        firmware: class of the other end.
        data_bitrate: of CAN FD frames [bit/s]; 0 = classical frames.
        state: newest complete one, with the sequence of the command that the hand has taken.
        incomplete: cycles dropped because a frame was lost or damaged.
    """

    firmware: ClassVar[type[HandFirmware]]
    data_bitrate: ClassVar[int] = 0

    def __init__(self, settings: HandSettings) -> None:
        """Nothing is known of the hand yet. Raises DgsError: the settings do not fit."""
        self.settings = settings
        self.state: HandState | None = None
        self.incomplete = 0

    def greet(self) -> list[can.Message]:
        """Frames to send when the bus has been opened, and again when there are frames but no states."""
        return []

    @abstractmethod
    def command(self, command: HandCommand) -> list[can.Message]:
        """Frames of a command; sent again until `state.accepted` is its `sequence`, which is 0..255."""

    @abstractmethod
    def receive(self, message: can.Message) -> bool:
        """Take a frame; whether it was the hand's and sound."""

    def follow_up(self) -> list[can.Message]:
        """Frames to send after every new state, of a hand that wants to be led."""
        return []

    @property
    @abstractmethod
    def fault(self) -> DgsError | None:
        """What is wrong with the hand at present, by its own word."""

    @property
    def absent(self) -> str:
        """Parts of the hand that said nothing in the last cycle, which was dropped; empty: it was complete."""
        return ""

    def clear_fault(self) -> list[can.Message]:
        """Frames that end a fault, before the next move; none: the hand does so itself."""
        return []


def protocol_class(hand: HandModel = HAND) -> type[HandProtocol]:
    """The class that the hand's folder names. Raises DgsError HAND_PROTOCOL: none, or it cannot be had."""
    if not hand.protocol:
        cure = "add `protocol: module:Class` to its hand.yaml (docs/your_hand.md)"
        raise DgsError(ErrorCode.HAND_PROTOCOL, f"no protocol of the hand {hand.name} is known; {cure}")
    module, _, name = hand.protocol.partition(":")
    try:
        found = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        missing = f"the protocol {hand.protocol} of the hand {hand.name} cannot be loaded: {error}"
        raise DgsError(ErrorCode.HAND_PROTOCOL, missing) from error
    if not (isinstance(found, type) and issubclass(found, HandProtocol)):
        raise DgsError(ErrorCode.HAND_PROTOCOL, f"{hand.protocol} of the hand {hand.name} is no HandProtocol")
    return found

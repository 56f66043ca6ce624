"""Opens the CAN bus to the hand, a real adapter's or the simulator's, and opens it again after a loss."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import can

from dgs_description.errors import DgsError, ErrorCode
from dgs_hand_driver.hand import DexHand

logger = logging.getLogger(__name__)

CONNECT_TIMEOUT = 2.0
"""[s]"""
RETRY_PERIOD = 0.5
"""Pause between two attempts, and between two looks at the connection [s]."""


@dataclass(frozen=True)
class BusSettings:
    """Which bus. `host` and `port` matter for the interface "socketcand" only, `bitrate` for adapters only."""

    interface: str = "socketcand"
    """Any name that python-can knows: socketcan, pcan, kvaser, slcan, socketcand, ..."""
    channel: str = "can0"
    host: str = "127.0.0.1"
    port: int = 29536
    bitrate: int = 1_000_000
    """[bit/s]"""

    def __post_init__(self) -> None:
        if self.interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise DgsError(
                ErrorCode.PARAMETER_INVALID,
                f"unknown CAN interface {self.interface!r}; python-can has {known}",
            )


def open_bus(settings: BusSettings) -> can.BusABC:
    """Open the bus.

    Raises:
        DgsError: HAND_BUS, it cannot be opened.
    """
    where = f"{settings.interface} {settings.channel}"
    options: dict[str, Any] = {"bitrate": settings.bitrate}
    try:
        if settings.interface == "socketcand":
            address = settings.host, settings.port
            where += " at {}:{}".format(*address)
            # python-can tries a refused connection again for 10 s without a pause: ask first whether anybody listens.
            socket.create_connection(address, timeout=CONNECT_TIMEOUT).close()
            # It also warns about every frame that TCP cut in two, although it puts the halves together.
            logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)
            options = {"host": settings.host, "port": settings.port, "tcp_tune": True}
        return can.Bus(interface=settings.interface, channel=settings.channel, **options)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        hint = "is the hand, its CAN adapter or the simulator on?"
        raise DgsError(ErrorCode.HAND_BUS, f"cannot open the CAN bus {where} ({error}); {hint}") from error


class HandConnection:
    """Owns the `DexHand` of the moment; the hand or the simulator may come later or come back."""

    def __init__(
        self, bus: BusSettings, make_hand: Callable[[can.BusABC], DexHand], retry_period: float = RETRY_PERIOD
    ) -> None:
        """Begin to connect in a thread of its own.

        Args:
            bus: to open.
            make_hand: wraps an open bus.
            retry_period: see `RETRY_PERIOD` [s].
        """
        self._bus, self._make_hand, self._retry_period = bus, make_hand, retry_period
        self._hand: DexHand | None = None
        self._reason = "the CAN bus has not been opened yet"
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="hand connection", daemon=True)
        self._thread.start()

    def hand(self) -> DexHand:
        """The connected hand.

        Raises:
            DgsError: HAND_BUS with the reason why there is none.
        """
        hand = self._hand
        if hand is None or hand.lost is not None:
            raise DgsError(ErrorCode.HAND_BUS, (hand.lost if hand else None) or self._reason)
        return hand

    def close(self) -> None:
        """Close the bus and stop connecting."""
        self._ended.set()
        self._thread.join()

    def _keep(self) -> None:
        while not self._ended.is_set():
            self._look()
            self._ended.wait(self._retry_period)
        if self._hand is not None:
            self._hand.close()

    def _look(self) -> None:
        hand = self._hand
        if hand is not None and hand.lost is not None:
            logger.warning("connection to the hand lost: %s", hand.lost)
            self._reason = hand.lost
            self._hand = None
            hand.close()
        if self._hand is None:
            try:
                self._hand = self._make_hand(open_bus(self._bus))
            except DgsError as error:
                self._reason = error.message

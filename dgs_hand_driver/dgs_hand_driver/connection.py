"""Keeps a connection to the hand: opens the bus, opens it again after a loss, and says what is wrong meanwhile."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import can

from dgs_description.errors import DgsError, ErrorCode
from dgs_hand_driver.hand import DexHand

logger = logging.getLogger(__name__)


class HandConnection:
    """Owns the `DexHand` of the moment; the hand or the simulator may come later or come back."""

    def __init__(
        self,
        open_bus: Callable[[], can.BusABC],
        make_hand: Callable[[can.BusABC], DexHand],
        retry_period: float = 0.5,
    ) -> None:
        """Begin to connect in a thread of its own.

        Args:
            open_bus: opens the bus or raises DgsError.
            make_hand: wraps an open bus.
            retry_period: pause between two attempts, and between two looks at the connection [s].
        """
        self._open_bus = open_bus
        self._make_hand = make_hand
        self._retry_period = retry_period
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
                self._hand = self._make_hand(self._open_bus())
            except DgsError as error:
                self._reason = error.message

"""The hand's end of the CAN bus for the simulator: takes the driver's commands and sends joint states as frames."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

import can

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array
from dgs_description.hand import HAND
from dgs_hand_driver.hand_state import HandCommand
from dgs_hand_driver.protocol import NO_FINGER, protocol_class
from dgs_sim_bridge.hand.socketcand_server import SocketcandServer

HEARTBEAT_PERIOD = 0.1
"""Time between two heartbeats, whatever the joints do [s]."""


class VirtualHand:
    """The firmware of this process's hand on a bus of its own, without the joints: those are the caller's.

    The caller moves them as `command` says, and tells of them by `publish_state` every `STATE_PERIOD`. What goes out by
    wall time, such as a heartbeat, does so while the hand runs: a paused simulation is no dead bus.
    """

    def __init__(self, port: int) -> None:
        """Describe the bus on this machine; nothing is opened before `start`. Port 0 takes any free one.

        Raises:
            DgsError: HAND_PROTOCOL, the hand's folder names no protocol, or one without the hand's end.
        """
        protocol = protocol_class()
        if not hasattr(protocol, "firmware"):
            lacks = (
                f"{HAND.protocol} of the hand {HAND.name} has no `firmware`, which the simulator speaks with"
            )
            raise DgsError(ErrorCode.HAND_PROTOCOL, f"{lacks} (docs/hand_can_protocol.md)")
        self._firmware = protocol.firmware()
        self._server = SocketcandServer(self._receive, port)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._heart: threading.Thread | None = None

    def start(self) -> None:
        """Open the port and begin to beat. Raises OSError when the port is in use."""
        self._server.start()
        self._ended.clear()
        self._heart = threading.Thread(target=self._beat, name="hand heartbeat", daemon=True)
        self._heart.start()

    def stop(self) -> None:
        """Close the port; harmless when not started."""
        self._ended.set()
        if self._heart is not None:
            self._heart.join()
            self._heart = None
        self._server.stop()

    @property
    def port(self) -> int:
        """The TCP port in use."""
        return self._server.port

    @property
    def clients(self) -> int:
        """How many drivers listen."""
        return self._server.clients

    def command(self) -> HandCommand:
        """Newest complete command; before the first one: position mode, `HAND.straight`, sequence 0. Thread-safe."""
        with self._lock:
            return self._firmware.command

    def publish_state(self, positions: Array, torques: Array, forces: Array, clock: float) -> None:
        """Send one cycle of state frames to all clients; never waits.

        Args:
            positions: (J,) measured joints [rad].
            torques: (J,) of the drives, positive in closing direction [Nm].
            forces: (F, 2) normal and tangential force on the fingertips [N].
            clock: simulated time of the measurement [s], from which the driver takes all its durations: a slow
                simulation is not a stalled hand.
        """
        with self._lock:
            frames = self._firmware.state(positions, torques, forces, clock)
        self._server.send(frames)

    def inject(self, fault: str, fingers: Sequence[bool] = NO_FINGER) -> None:
        """Report a fault that the protocol knows ("none" ends it). Raises ValueError."""
        with self._lock:
            frames = self._firmware.inject(fault, fingers)
        self._server.send(frames)

    def _beat(self) -> None:
        start = time.monotonic()
        while not self._ended.wait(HEARTBEAT_PERIOD):
            with self._lock:
                frames = self._firmware.beat(time.monotonic() - start)
            if frames:
                self._server.send(frames)

    def _receive(self, message: can.Message) -> None:
        with self._lock:
            answer = self._firmware.receive(message)
        if answer:
            self._server.send(answer)

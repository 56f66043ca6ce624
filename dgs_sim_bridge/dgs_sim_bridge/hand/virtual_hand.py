"""The hand's end of the CAN bus for the simulator: takes the driver's commands and sends joint states as frames."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import can
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.frames import Array
from dgs_description.joints import HAND_LOWER, HAND_SPEED, HAND_UPPER
from dgs_hand_driver.can_protocol import (
    HEARTBEAT_PERIOD,
    STATE_PERIOD,
    FingerFrame,
    HandProtocol,
    Mode,
    ModeFrame,
    expand_positions,
)
from dgs_sim_bridge.hand.socketcand_server import SocketcandServer


@dataclass(frozen=True)
class HandCommand:
    """The newest complete command of the driver."""

    mode: Mode = "position"
    target: Array = field(default_factory=lambda: np.zeros(20))
    """(20,) within the limits, joint4 = joint3 [rad]"""
    speed: float = HAND_SPEED
    """limit of every joint [rad/s]"""
    active: NDArray[np.bool_] = field(default_factory=lambda: np.ones(5, dtype=bool))
    """(5,) fingers that comply in admittance mode"""
    sequence: int = 0
    """counts the commands taken; a change means a new command"""


class VirtualHand:
    """What the hand's firmware does on the bus, without the joints: those are the caller's.

        hand = VirtualHand()
        hand.start()
        while simulating:
            command = hand.command()          # new command <=> command.sequence changed
            ...                               # move the joints
            hand.publish_state(positions, torques, clock)     # every 0.01 s of simulated time
        hand.stop()

    In mode "position" the joints go to `target` at `speed`; in mode "admittance" the fingers of `active` comply
    (`AdmittanceController.start(measured, target, active, speed)`, the closing margin is in the target already);
    in mode "hold" they stay stiffly at `target`, which is where the driver measured them.

    A heartbeat goes out every 0.1 s of wall time while the hand runs, so a paused simulation is not a dead bus.
    """

    def __init__(self, port: int = 29536) -> None:
        """Describe the bus on this machine; nothing is opened before `start`. Port 0 takes any free one."""
        self._protocol = HandProtocol()
        self._server = SocketcandServer(self._receive, port)
        self._lock = threading.Lock()
        self._command = HandCommand()
        self._pending: dict[int, FingerFrame] = {}
        self._accepted: tuple[bytes, int] | None = None
        self._cycle = 0
        self._beats = 0
        self._fault: tuple[str, Sequence[bool]] = ("none", (False,) * 5)
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
        """Newest complete command; before the first one: position mode, all joints zero, sequence 0. Thread-safe."""
        with self._lock:
            return self._command

    def publish_state(self, positions: ArrayLike, torques: ArrayLike, clock: float | None = None) -> None:
        """Send one cycle of state frames to all clients; never waits.

        Args:
            positions: (20,) measured joints [rad].
            torques: (20,) of the drives, positive in closing direction [Nm].
            clock: simulated time of the measurement [s], from which the driver takes all its durations: a slow
                simulation is not a stalled hand. None: 0.01 s per call.
        """
        with self._lock:
            self._cycle += 1
            cycle, mode = self._cycle, self._command.mode
            accepted = self._accepted[1] if self._accepted else 0
        now = cycle * STATE_PERIOD if clock is None else clock
        self._server.send(self._protocol.encode_state(positions, torques, mode, accepted, now, cycle & 0xFF))

    def inject(self, fault: str, fingers: Sequence[bool] = (False,) * 5) -> None:
        """Report a fault of the DBC's table ("none" ends it), at once and with every heartbeat. Raises ValueError."""
        frame = self._protocol.encode_fault(fault, fingers, 0)
        with self._lock:
            self._fault = (fault, fingers)
        self._server.send([frame])

    def _beat(self) -> None:
        start = time.monotonic()
        while not self._ended.wait(HEARTBEAT_PERIOD):
            with self._lock:
                self._beats = (self._beats + 1) & 0xFF
                beat, (fault, fingers) = self._beats, self._fault
            frames = [self._protocol.encode_heartbeat(time.monotonic() - start, beat)]
            if fault != "none":
                frames.append(self._protocol.encode_fault(fault, fingers, beat))
            self._server.send(frames)

    def _receive(self, message: can.Message) -> None:
        frame = self._protocol.decode(message)
        if isinstance(frame, FingerFrame) and frame.kind == "command":
            self._pending[frame.finger] = frame
        elif isinstance(frame, ModeFrame):
            self._commit(frame, bytes(message.data))

    def _commit(self, frame: ModeFrame, data: bytes) -> None:
        pending = [self._pending[finger] for finger in sorted(self._pending)]
        values = [finger.values for finger in pending if finger.sequence == frame.sequence]
        if len(values) < 5:
            return  # a frame was lost: no acknowledgement, so the driver sends the command again
        target = np.clip(expand_positions(values), HAND_LOWER, HAND_UPPER)
        content = data + np.asarray(values).tobytes()
        with self._lock:
            if self._accepted and self._accepted[0] == content:
                return  # sent again although it had come: taken only once
            self._accepted = (content, frame.sequence)
            active, number = np.array(frame.active), self._command.sequence + 1
            self._command = HandCommand(frame.mode, target, frame.speed, active, number)

"""Opens the CAN bus to the hand: a real adapter's or the simulator's, by name."""

from __future__ import annotations

import logging
import os
import socket
from dataclasses import dataclass
from typing import Any

import can

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import parameter

CONNECT_TIMEOUT = 2.0
"""[s]"""
_SOCKETCAND_PORT = 29536


def bus_port(given: int = 0) -> int:
    """TCP port of a socketcand server; 0 = that of the simulated hand of this ROS domain.

    Two suites in two domains must not meet on one bus, however their nodes are started.
    """
    return given or _SOCKETCAND_PORT + int(os.environ.get("ROS_DOMAIN_ID") or 0)


@dataclass(frozen=True)
class BusSettings:
    """Which bus. `host` and `port` matter for the interface "socketcand" only, `bitrate` for adapters only."""

    interface: str = parameter(
        "socketcand", "python-can interface: socketcan, pcan, socketcand (simulator), ..."
    )
    channel: str = parameter("can0", "Channel of the interface.")
    host: str = parameter("127.0.0.1", "Host of the socketcand server; other interfaces do not use it.")
    port: int = parameter(0, "Port of the socketcand server; 0 = 29536 + ROS_DOMAIN_ID.", 0, 65535)
    bitrate: int = parameter(1_000_000, "Of the CAN bus [bit/s].", 10_000, 1_000_000)

    def __post_init__(self) -> None:
        if self.interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            unknown = f"unknown CAN interface {self.interface!r}; python-can has {known}"
            raise DgsError(ErrorCode.PARAMETER_INVALID, unknown)


def open_bus(settings: BusSettings, data_bitrate: int = 0) -> can.BusABC:
    """Open the bus, for CAN FD frames where `data_bitrate` [bit/s] is not 0. Raises DgsError HAND_BUS: it cannot."""
    where = f"{settings.interface} {settings.channel}"
    options: dict[str, Any] = {"bitrate": settings.bitrate}
    if data_bitrate:
        options |= {"fd": True, "data_bitrate": data_bitrate}
    try:
        if settings.interface == "socketcand":
            address = host, port = settings.host, bus_port(settings.port)
            where += " at {}:{}".format(*address)
            # python-can tries a refused connection again for 10 s without a pause: ask first whether anybody listens.
            socket.create_connection(address, timeout=CONNECT_TIMEOUT).close()
            # It also warns about every frame that TCP cut in two, although it puts the halves together.
            logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)
            options = {"host": host, "port": port, "tcp_tune": True}
        return can.Bus(interface=settings.interface, channel=settings.channel, **options)
    except Exception as error:  # each adapter has its own
        hint = "is the hand, its CAN adapter or the simulator on?"
        raise DgsError(ErrorCode.HAND_BUS, f"cannot open the CAN bus {where} ({error}); {hint}") from error

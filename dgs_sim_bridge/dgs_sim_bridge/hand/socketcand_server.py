"""A CAN bus on a TCP port of this machine: the part of the socketcand protocol that python-can's client speaks."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import Future

import can
from can.util import CAN_FD_DLC

logger = logging.getLogger(__name__)

# python-can reads the answer to "rawmode" with one recv and takes anything behind it for an error: no frame may follow
# before the client has had time to read.
QUIET_AFTER_RAWMODE = 0.1
"""[s]"""
HOST = "127.0.0.1"
CHANNEL = "can0"
"""The only name that clients may open."""
MAX_BACKLOG = 256 * 1024
"""A client that leaves this much unread gets no more frames until it has read [bytes]."""
MAX_REQUEST = 4096
"""Longer requests end the connection [bytes]."""


class SocketcandServer:
    """Serves one channel to any number of clients; a frame from one client goes to the owner and to the other clients.

    Runs an asyncio loop in a thread of its own; `send` may be called from any thread and never waits for a client.
    Protocol: https://github.com/linux-can/socketcand, raw mode.
    """

    def __init__(self, on_frame: Callable[[can.Message], None], port: int) -> None:
        """Describe the bus; nothing is opened yet.

        Args:
            on_frame: called in the server's thread with every frame that a client sends.
            port: TCP port, 0 = any free one (see `port` after `start`).
        """
        self._on_frame = on_frame
        self.port = port
        self._raw: set[asyncio.StreamWriter] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Listen. Raises OSError when the address is in use."""
        if self._thread is not None:
            raise RuntimeError("the server runs already")
        listening: Future[asyncio.AbstractEventLoop] = Future()
        thread = threading.Thread(
            target=lambda: asyncio.run(self._run(listening)), name="socketcand", daemon=True
        )
        thread.start()
        self._loop, self._thread = listening.result(), thread

    def stop(self) -> None:
        """Close all connections; harmless when not started."""
        if self._loop is None or self._thread is None:
            return
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()
        self._loop = self._thread = None

    def send(self, frames: Iterable[can.Message]) -> None:
        """Put frames on the bus: every client gets them; without a client they are lost, as on a real bus."""
        loop = self._loop
        if loop is None:
            return
        text = "".join(format_frame(frame) for frame in frames).encode()
        try:
            loop.call_soon_threadsafe(self._broadcast, text, None)
        except RuntimeError:  # the loop was closed by `stop` in another thread
            logger.debug("frame dropped: the server stops")

    @property
    def clients(self) -> int:
        """How many clients receive frames."""
        return len(self._raw)

    async def _run(self, listening: Future[asyncio.AbstractEventLoop]) -> None:
        self._ended = asyncio.Event()
        try:
            server = await asyncio.start_server(self._serve, HOST, self.port, limit=MAX_REQUEST)
        except OSError as error:
            listening.set_exception(error)
            return
        self.port = int(server.sockets[0].getsockname()[1])
        listening.set_result(asyncio.get_running_loop())
        await self._ended.wait()
        server.close()  # asyncio.run cancels what still serves a client

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            writer.write(b"< hi >")
            while True:
                request = await reader.readuntil(b">")
                self._answer(request.decode("ascii", errors="replace"), writer)
        except (EOFError, asyncio.LimitOverrunError, ConnectionError, asyncio.CancelledError):
            logger.debug("socketcand client gone")
        finally:
            self._raw.discard(writer)
            writer.close()

    def _answer(self, request: str, writer: asyncio.StreamWriter) -> None:
        words = request[request.find("<") + 1 : -1].split()
        match words:
            case ["open", name] if name == CHANNEL:
                writer.write(b"< ok >")
            case ["open", name]:
                writer.write(f"< error no bus {name}, only {CHANNEL} >".encode())
            case ["rawmode"]:
                writer.write(b"< ok >")
                asyncio.get_running_loop().call_later(QUIET_AFTER_RAWMODE, self._join, writer)
            case ["echo"]:
                writer.write(b"< echo >")
            case ["send", *fields]:
                self._receive(fields, writer)
            case _:
                writer.write(b"< error unknown command >")

    def _join(self, writer: asyncio.StreamWriter) -> None:
        if not writer.is_closing():
            self._raw.add(writer)

    def _receive(self, fields: list[str], writer: asyncio.StreamWriter) -> None:
        try:
            frame = parse_send(fields)
        except ValueError:
            writer.write(b"< error syntax >")
            return
        self._broadcast(format_frame(frame).encode(), writer)
        try:
            self._on_frame(frame)
        except Exception:
            # The owner's fault must not cut the client off.
            logger.exception("the receiver of CAN frames failed")

    def _broadcast(self, text: bytes, sender: asyncio.StreamWriter | None) -> None:
        for writer in list(self._raw):
            if writer is sender or writer.is_closing():
                continue
            if writer.transport.get_write_buffer_size() < MAX_BACKLOG:
                writer.write(text)


def parse_send(fields: list[str]) -> can.Message:
    """Frame of the words after `send`: identifier, length, bytes, all hexadecimal. Raises ValueError."""
    if len(fields) < 2 or len(fields[0]) not in (3, 8):
        raise ValueError("a frame has a 3 or 8 digit identifier and a length")
    data = bytes(int(field, 16) for field in fields[2:])
    if int(fields[1], 16) != len(data) or len(data) not in CAN_FD_DLC:
        raise ValueError(f"length {fields[1]} but {len(data)} bytes")
    number, extended = int(fields[0], 16), len(fields[0]) == 8
    # The protocol has no flag for CAN FD; python-can's client writes any length.
    return can.Message(time.time(), number, extended, data=data, is_fd=len(data) > 8, check=True)


def format_frame(frame: can.Message) -> str:
    """The line by which the server tells clients of a frame."""
    identifier = f"{frame.arbitration_id:08X}" if frame.is_extended_id else f"{frame.arbitration_id:03X}"
    return f"< frame {identifier} {frame.timestamp or time.time():.6f} {bytes(frame.data).hex().upper()} >"

"""The page's door: other web pages cannot steer the robot through a visitor's browser; others need a token.

A browser sends a request's `Origin`, so a page from elsewhere is known by it. A name that somebody points at this
machine is known by `Host`. viser looks at neither. Its server closes every connection after one answer, except the
websocket, so it is enough to look at the first request and to pass everything else on as it comes.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import socket
import threading
from hashlib import sha256
from ipaddress import ip_address
from urllib.parse import parse_qs, quote, urlsplit

from dgs_description.errors import DgsError, ErrorCode

_MOST_HEADER = 32_768
_TRIES = 10
_COOKIE = "dgs_viewer"
_PATIENCE = 10.0
"""Wait for a request's header [s]."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address or name."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Gate:
    """Listens on an address and passes what may come in on to a server of this machine.

    Attributes:
        token: what a visitor must bring once as `?token=`; "" = nothing, on loopback.
        port: where it listens.
    """

    def __init__(self, host: str, port: int, inner: tuple[str, int], token: str = "") -> None:
        """Begin to listen on `port`, or on one of the next free ones; 0 = any.

        Args:
            inner: host and port of the server behind.
            token: off loopback one is made if none is given.

        Raises:
            DgsError: PARAMETER_INVALID: all are in use, or the address is not one of this machine.
        """
        self.token = token or ("" if is_loopback(host) else secrets.token_urlsafe(12))
        self._host, self._inner, self._local = host, inner, is_loopback(host)
        self._pass = sha256(self.token.encode()).hexdigest()  # a token may hold what a cookie must not
        self._loop = asyncio.new_event_loop()
        self.port = self._bind(port)
        self._thread = threading.Thread(target=self._loop.run_forever, name="gate", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host = socket.gethostname() if self._host in ("", "0.0.0.0", "::") else self._host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={quote(self.token, safe='')}" if self.token else "")

    def close(self) -> None:
        """End."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(1.0)

    def _bind(self, port: int) -> int:
        last = "no port was tried"
        for number in range(port, min(port + _TRIES, 65536)) if port else (0,):
            try:
                listening = asyncio.start_server(self._serve, self._host, number, limit=_MOST_HEADER)
                server = self._loop.run_until_complete(listening)
                return int(server.sockets[0].getsockname()[1])
            except (OSError, UnicodeError) as error:  # the second of a name with two dots in a row
                last = str(error)
        wrong = f"the page cannot listen on {self._host} port {port} or the next {_TRIES - 1}: {last}"
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{wrong}; set the parameters host and port")

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner: asyncio.StreamWriter | None = None
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _PATIENCE)
            refusal = self.answer(head.decode("latin-1"))
            if refusal:
                writer.write(refusal.encode("latin-1"))
                await writer.drain()
                return
            inner_reader, inner = await asyncio.open_connection(*self._inner)
            inner.write(head)
            await asyncio.gather(_pump(reader, inner), _pump(inner_reader, writer))
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            pass  # the visitor has left, or sent no request
        finally:
            for stream in (writer, inner):
                if stream is not None:
                    stream.close()

    def answer(self, head: str) -> str:
        """What a request (its line and header fields) is answered that may not come in, or not yet; "" = it may."""
        try:
            return self._judge(head)
        except ValueError:
            return _response("400 Bad Request", "this is no request of a browser")

    def _judge(self, head: str) -> str:
        lines = head.split("\r\n")
        fields = {
            name.strip().lower(): value.strip()
            for name, _, value in (line.partition(":") for line in lines[1:])
        }
        host, origin = fields.get("host", ""), fields.get("origin")
        if self._local and not is_loopback(urlsplit(f"//{host}").hostname or ""):
            page = self.address.partition("?")[0]  # who may not come in is not told the token
            return _response("403 Forbidden", f"open {page} on the machine that runs the suite")
        if origin is not None and urlsplit(origin).netloc != host:
            return _response("403 Forbidden", "another web page may not steer this one")
        if not self.token:
            return ""
        target = urlsplit((lines[0].split(" ") + [""])[1])
        # Browsers send the cookies of all of this machine's ports, also such that http.cookies gives up at.
        cookies = dict(each.strip().partition("=")[::2] for each in fields.get("cookie", "").split(";"))
        if _same(cookies.get(f"{_COOKIE}_{self.port}", ""), self._pass):
            return ""
        if _same(parse_qs(target.query).get("token", [""])[0], self.token):
            # Lax: where the address is clicked on another web page, Strict is left out of what the redirection asks.
            keep = f"Set-Cookie: {_COOKIE}_{self.port}={self._pass}; HttpOnly; SameSite=Lax; Path=/\r\n"
            return _response("303 See Other", "", f"Location: {target.path or '/'}\r\n{keep}")
        return _response("401 Unauthorized", "add ?token=... to the address, as the suite has printed it")


async def _pump(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while data := await reader.read(65_536):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()


def _same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode(), wanted.encode())


def _response(status: str, text: str, more: str = "") -> str:
    size = len(text.encode())
    head = f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {size}\r\n"
    return f"{head}{more}Connection: close\r\n\r\n{text}"

"""Who may come in."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from dgs_description.errors import ErrorCode
from dgs_viewer.gate import Gate, is_loopback
from tests.support.refused import refused


class Inner(BaseHTTPRequestHandler):
    """The page behind the gate."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"inside " + self.path.encode())

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def inner() -> Iterator[tuple[str, int]]:
    server = HTTPServer(("127.0.0.1", 0), Inner)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield "127.0.0.1", server.server_port
    server.shutdown()
    server.server_close()


@pytest.fixture
def local(inner: tuple[str, int]) -> Iterator[Gate]:
    with closing(Gate("127.0.0.1", 0, inner)) as gate:
        yield gate


@pytest.fixture
def guarded(inner: tuple[str, int]) -> Iterator[Gate]:
    with closing(Gate("127.0.0.1", 0, inner, token="open sesame")) as gate:
        yield gate


def get(gate: Gate, path: str = "/", **fields: str) -> tuple[int, str, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=20)
    with closing(connection):
        connection.request("GET", path, headers=fields)
        answer = connection.getresponse()
        return answer.status, answer.read().decode(), dict(answer.getheaders())


def test_on_this_machine_everybody_may_look(local: Gate):
    assert local.token == ""
    assert local.address == f"http://127.0.0.1:{local.port}/"
    assert get(local, "/x?y=1")[:2] == (200, "inside /x?y=1")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "10.1.2.3"])
def test_a_foreign_name_for_this_machine_is_refused(local: Gate, host: str):
    status, text, _ = get(local, Host=host)
    assert status == 403
    assert local.address in text


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]"])
def test_its_own_names_are_known(local: Gate, name: str):
    assert get(local, Host=f"{name}:{local.port}")[0] == 200


def test_another_web_page_may_not_steer(local: Gate):
    own = f"127.0.0.1:{local.port}"
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade"}
    assert get(local, Origin="https://evil.example", **upgrade)[0] == 403
    assert get(local, Origin="http://127.0.0.1:1", **upgrade)[0] == 403
    assert get(local, Origin="null")[0] == 403
    assert get(local, Origin=f"http://{own}", Host=own)[0] == 200


def test_without_the_token_nobody_comes_in(guarded: Gate):
    for path in ("/", "/?token=", "/?token=wrong"):
        status, text, _ = get(guarded, path)
        assert status == 401
        assert "token" in text
    assert get(guarded, Cookie=f"dgs_viewer_{guarded.port}=wrong")[0] == 401
    status, text, _ = get(guarded, Host="evil.example")
    assert status == 403 and f"127.0.0.1:{guarded.port}/ " in text and "sesame" not in text


def test_who_brings_the_token_once_comes_in_for_good(guarded: Gate):
    status, _, fields = get(guarded, "/?token=open%20sesame")
    assert (status, fields["Location"]) == (303, "/")
    assert "HttpOnly" in fields["Set-Cookie"] and "SameSite=Lax" in fields["Set-Cookie"]
    cookie = fields["Set-Cookie"].split(";")[0]
    assert get(guarded, Cookie=cookie)[:2] == (200, "inside /")
    others = 'layout={"left": [1, 2]}; a[b]=1; flag'  # of other pages of this machine: cookies know no ports
    assert get(guarded, Cookie=f"{others}; {cookie}; {others}")[:2] == (200, "inside /")


@pytest.mark.parametrize(("host", "name"), [("::1", "[::1]"), ("::", socket.gethostname())])
def test_the_address_of_ipv6_can_be_opened(inner: tuple[str, int], host: str, name: str):
    if not socket.has_dualstack_ipv6():
        pytest.skip("this machine has no IPv6")
    with closing(Gate(host, 0, inner)) as gate:
        assert gate.address.startswith(f"http://{name}:{gate.port}/")


def test_off_loopback_there_is_always_a_token(inner: tuple[str, int]):
    with closing(Gate("0.0.0.0", 0, inner)) as gate:
        assert len(gate.token) >= 12
        assert get(gate)[0] == 401
        assert gate.address == f"http://{socket.gethostname()}:{gate.port}/?token={gate.token}"


def test_a_port_in_use_is_passed_over(inner: tuple[str, int]):
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        with closing(Gate("127.0.0.1", port, inner)) as gate:
            assert port < gate.port < port + 10


@pytest.mark.parametrize("host", ["192.0.2.1", "192.0..1"])
def test_an_address_of_another_machine_or_of_none_is_refused(inner: tuple[str, int], host: str):
    with refused(ErrorCode.PARAMETER_INVALID, "host and port"):
        Gate(host, 8080, inner)


def test_noise_does_not_end_the_gate(local: Gate):
    for noise in (b"", b"nonsense\r\n\r\n", b"x" * 100_000):
        with closing(socket.create_connection(("127.0.0.1", local.port), timeout=20)) as visitor:
            try:
                visitor.sendall(noise)
            except OSError:
                pass  # the gate has hung up on it
    assert get(local)[0] == 200


def test_loopback_names():
    assert all(is_loopback(name) for name in ("127.0.0.1", "::1", "[::1]", "localhost", "127.8.8.8"))
    assert not any(is_loopback(name) for name in ("0.0.0.0", "10.0.0.1", "localhost.evil.example", ""))

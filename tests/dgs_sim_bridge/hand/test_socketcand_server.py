import socket
import threading
import time
from collections.abc import Iterator

import can
import pytest

from dgs_hand_driver.bus import BusSettings, open_bus
from dgs_sim_bridge.hand import socketcand_server
from dgs_sim_bridge.hand.socketcand_server import (
    MAX_BACKLOG,
    SocketcandServer,
    parse_send,
)
from tests.support.environment import wait_until


@pytest.fixture
def received() -> list[can.Message]:
    return []


@pytest.fixture
def server(received: list[can.Message]) -> Iterator[SocketcandServer]:
    server = SocketcandServer(received.append, port=0)
    server.start()
    yield server
    server.stop()


def connect(server: SocketcandServer) -> can.BusABC:
    before = server.clients
    bus = open_bus(BusSettings(port=server.port))
    wait_until(lambda: server.clients == before + 1)
    return bus


def same(one: can.Message, other: can.Message) -> bool:
    return one.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0x101, data=[0, 1, 0xFF, 0x10, 5, 6, 7, 8], is_extended_id=False),
        can.Message(arbitration_id=0x7, data=[], is_extended_id=False),
        can.Message(arbitration_id=0x1ABCDEF, data=[0x0A], is_extended_id=True),
        can.Message(
            arbitration_id=0x187, data=range(64), is_extended_id=False
        ),  # of CAN FD, told by its length only
    ],
)
def test_frames_reach_the_owner_and_the_other_clients(server, received, frame) -> None:
    with connect(server) as sender, connect(server) as listener:
        sender.send(frame)
        heard = listener.recv(timeout=5.0)
        assert heard is not None and same(heard, frame)
        wait_until(lambda: len(received) == 1)
        received[0].is_fd = False
        assert same(received[0], frame)
        assert sender.recv(timeout=0.05) is None


def test_owner_reaches_all_clients(server) -> None:
    frames = [can.Message(arbitration_id=i, data=[i] * 8, is_extended_id=False) for i in range(1, 100)]
    with connect(server) as one, connect(server) as other:
        server.send(frames)
        for bus in (one, other):
            assert [bus.recv(timeout=5.0).arbitration_id for _ in frames] == list(range(1, 100))


def test_clients_may_come_while_frames_fly(server) -> None:
    frames = [can.Message(arbitration_id=i, data=bytes(8), is_extended_id=False) for i in range(11)]
    ended = threading.Event()

    def talk() -> None:
        while not ended.wait(0.0005):
            server.send(frames)

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        for _ in range(5):
            with open_bus(BusSettings(port=server.port)) as bus:
                assert bus.recv(timeout=5.0) is not None
    finally:
        ended.set()
        talker.join()


def test_wrong_channel_is_refused(server) -> None:
    with pytest.raises(can.CanError, match="no bus can7"):
        can.Bus(interface="socketcand", host="127.0.0.1", port=server.port, channel="can7")
    assert server.clients == 0


def exchange(connection: socket.socket, request: bytes) -> bytes:
    connection.sendall(request)
    return connection.recv(256)


def test_nonsense_is_answered_and_the_connection_survives(server, received) -> None:
    with socket.create_connection(("127.0.0.1", server.port), timeout=5.0) as raw:
        assert raw.recv(256) == b"< hi >"
        assert exchange(raw, b"< dance >") == b"< error unknown command >"
        assert exchange(raw, b"< send 101 9 1 >") == b"< error syntax >"
        assert exchange(raw, b"< send xyz 1 1 >") == b"< error syntax >"
        assert exchange(raw, b"\xff\xfe >") == b"< error unknown command >"
        assert exchange(raw, b"< echo >") == b"< echo >"
        assert exchange(raw, b"< send 101 2 1 ff >< echo >") == b"< echo >"
    wait_until(lambda: len(received) == 1)
    assert bytes(received[0].data) == b"\x01\xff"


def test_endless_request_ends_that_connection_only(server) -> None:
    with connect(server) as good, socket.create_connection(("127.0.0.1", server.port), timeout=5.0) as bad:
        assert bad.recv(256) == b"< hi >"
        bad.sendall(b"x" * 20_000)
        with pytest.raises((ConnectionError, EOFError)):
            while bad.recv(256):
                pass
            raise EOFError
        server.send([can.Message(arbitration_id=1, data=[1], is_extended_id=False)])
        assert good.recv(timeout=5.0) is not None


def test_clients_may_vanish(server) -> None:
    gone, stays = connect(server), connect(server)
    gone.shutdown()
    frame = can.Message(arbitration_id=1, data=[1], is_extended_id=False)
    with stays:
        for _ in range(20):
            server.send([frame])
        assert all(stays.recv(timeout=5.0) is not None for _ in range(20))
        wait_until(lambda: server.clients == 1)


def open_raw(server: SocketcandServer) -> socket.socket:
    raw = socket.create_connection(("127.0.0.1", server.port), timeout=5.0)
    assert raw.recv(256) == b"< hi >"
    assert exchange(raw, b"< open can0 >") == b"< ok >"
    return raw


def test_no_frame_comes_right_behind_the_answer_to_rawmode(server, monkeypatch) -> None:
    # python-can would take it for an error.
    monkeypatch.setattr(socketcand_server, "QUIET_AFTER_RAWMODE", 2.0)
    frame = can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False)
    with open_raw(server) as raw:
        raw.sendall(b"< rawmode >")
        end = time.monotonic() + 0.03
        while time.monotonic() < end:
            server.send([frame])
            time.sleep(0.001)
        assert raw.recv(4096) == b"< ok >"
        wait_until(lambda: server.clients == 1)
        server.send([frame])
        assert raw.recv(4096).startswith(b"< frame 001 ")


def test_client_that_does_not_read_holds_nobody_up(server) -> None:
    frames = [can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False)] * 500
    with open_raw(server) as deaf, open_raw(server) as good:
        for raw in (deaf, good):
            assert exchange(raw, b"< rawmode >") == b"< ok >"
        wait_until(lambda: server.clients == 2)
        sent, heard = 0, 0
        # Several times what the sockets and the server keep for the deaf one.
        while sent < 40 * MAX_BACKLOG // 50:
            server.send(frames)
            sent += len(frames)
            while heard < sent:
                heard += good.recv(1 << 16).count(b">")
        deaf.settimeout(0.3)
        got = 0
        with pytest.raises(TimeoutError):
            while True:
                got += deaf.recv(1 << 16).count(b">")
        assert 0 < got < sent


def test_failing_owner_does_not_cut_the_client_off() -> None:
    calls: list[int] = []

    def fail(frame: can.Message) -> None:
        calls.append(frame.arbitration_id)
        raise RuntimeError("owner")

    server = SocketcandServer(fail, port=0)
    server.start()
    try:
        with connect(server) as bus:
            for i in (1, 2):
                bus.send(can.Message(arbitration_id=i, data=[], is_extended_id=False))
            wait_until(lambda: calls == [1, 2])
    finally:
        server.stop()


def test_port_in_use_is_said(server) -> None:
    second = SocketcandServer(lambda _: None, port=server.port)
    with pytest.raises(OSError, match="in use"):
        second.start()
    second.stop()


def test_stop_frees_the_port_and_may_come_twice(server) -> None:
    with connect(server):
        server.stop()
        server.stop()
        again = SocketcandServer(lambda _: None, port=server.port)
        again.start()
        again.stop()
    server.send([can.Message(arbitration_id=1)])  # no loop any more: lost, not an error


@pytest.mark.parametrize(
    "fields", [[], ["101"], ["1", "0"], ["101", "1"], ["101", "9", *"123456789"], ["800", "0"]]
)
def test_parse_send_refuses(fields: list[str]) -> None:
    with pytest.raises(ValueError):
        parse_send(fields)

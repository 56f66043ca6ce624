"""Nothing of the suite can be reached from another machine, as the kernel lists its sockets."""

from __future__ import annotations

import ipaddress
import re
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.support.environment import reserved_domain_id
from tests.support.processes import group_members
from tests.support.ros_client import RosClient
from tests.support.suite import Suite

pytestmark = [pytest.mark.integration, pytest.mark.slow]

LISTEN = "0A"
READ_SOON = 2.0
"""A process that reads from a socket has read what came after so long [s]."""


class Socket(NamedTuple):
    """A line of /proc/net that belongs to a process of a node."""

    node: str
    protocol: str
    address: str
    port: int
    unread: int
    """Bytes that have come and that nobody has taken."""


def sockets(node: str, process: int) -> Iterator[Socket]:
    """What a process listens or may receive on."""
    inodes = set()
    for descriptor in Path(f"/proc/{process}/fd").iterdir():
        with suppress(FileNotFoundError):
            inodes.update(re.findall(r"socket:\[(\d+)\]", str(descriptor.readlink())))
    for protocol in ("tcp", "tcp6", "udp", "udp6"):
        for line in Path(f"/proc/{process}/net/{protocol}").read_text().splitlines()[1:]:
            words = line.split()
            address, port = words[1].split(":")
            if words[9] in inodes and (protocol.startswith("udp") or words[3] == LISTEN):
                yield Socket(
                    node, protocol, _address(address), int(port, 16), int(words[4].split(":")[1], 16)
                )


def _address(hexadecimal: str) -> str:
    """An address as /proc writes it: words of 32 bits in the machine's own order."""
    raw = b"".join(bytes.fromhex(hexadecimal[k : k + 8])[::-1] for k in range(0, len(hexadecimal), 8))
    return socket.inet_ntop(socket.AF_INET if len(raw) == 4 else socket.AF_INET6, raw)


def of(suite: Suite) -> list[Socket]:
    """All sockets of all nodes."""
    processes = [(name, pid) for name, node in suite.nodes.items() for pid in group_members(node.process.pid)]
    return [found for name, pid in processes for found in sockets(name, pid)]


def beyond_loopback(found: list[Socket]) -> list[Socket]:
    """Sockets that a packet from another machine could reach."""
    return [item for item in found if not ipaddress.ip_address(item.address).is_loopback]


def test_nothing_is_read_from_beyond_loopback(tmp_path: Path) -> None:
    with (
        reserved_domain_id() as domain_id,
        RosClient(domain_id) as client,
        Suite(domain_id, client, tmp_path, {"sim_bridge_node": {"objects": 0}}) as suite,
    ):
        found = of(suite)
        assert {item.node for item in found if item.protocol == "udp"} == set(suite.nodes)
        listening = [item[:4] for item in found if item.protocol.startswith("tcp")]
        assert listening == [("sim_bridge_node", "tcp", "127.0.0.1", 29536 + domain_id)]
        # Fast DDS sends through sockets that are open to every interface. It must not read from them: what comes stays.
        ways_out = beyond_loopback(found)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for item in ways_out:
                sender.sendto(
                    b"hello", ("127.0.0.1" if item.address == "0.0.0.0" else item.address, item.port)
                )
        time.sleep(READ_SOON)
        after = beyond_loopback(of(suite))
    assert {item[:4] for item in after} == {item[:4] for item in ways_out}
    read = [item for item in after if not item.unread]
    assert not read, f"somebody reads what other machines may send: {read}"

"""One suite of all nodes, looked at in turn.

Nothing of it can be reached from another machine, as the kernel lists its sockets; `plan_pick` predicts and plans;
example 4 picks.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from dgs_interfaces.msg import SimState

from dgs_description.cell import CELL
from dgs_description.frames import apply, inverse
from dgs_ros.base_node import LATCHED
from dgs_ros.pose_msgs import to_array
from dgs_sim_bridge.render.d455 import D455
from tests.support.environment import reserved_domain_id, run
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


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Suite]:
    logs = tmp_path_factory.mktemp("suite")
    with (
        reserved_domain_id() as domain,
        RosClient(domain) as client,
        Suite(domain, client, logs, {}) as suite,
    ):
        yield suite


def test_nothing_is_read_from_beyond_loopback(suite: Suite) -> None:
    found = of(suite)
    assert {item.node for item in found if item.protocol == "udp"} == set(suite.nodes)
    listening = [item[:4] for item in found if item.protocol.startswith("tcp")]
    assert listening == [("sim_bridge_node", "tcp", "127.0.0.1", 29536 + suite.domain_id)]
    # Fast DDS sends through sockets that are open to every interface. It must not read from them: what comes stays.
    ways_out = beyond_loopback(found)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for item in ways_out:
            sender.sendto(b"hello", ("127.0.0.1" if item.address == "0.0.0.0" else item.address, item.port))
    time.sleep(READ_SOON)
    after = beyond_loopback(of(suite))
    assert {item[:4] for item in after} == {item[:4] for item in ways_out}
    read = [item for item in after if not item.unread]
    assert not read, f"somebody reads what other machines may send: {read}"


def test_plan_pick_plans_and_moves_nothing(suite: Suite) -> None:
    out = run("ros2", "run", "dgs_bringup", "plan_pick", "--seed", "1", domain=suite.domain_id)
    assert "grasps in base_link from" in out and "nothing was moved" in out


def test_example_4_picks_what_is_at_a_pixel(suite: Suite) -> None:
    state = suite.client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]
    places = np.array([to_array(pose.position) for pose in state.poses])
    away = np.linalg.norm(places[:, None] - places, axis=-1) + np.eye(len(places))
    chosen = int(np.argmax(away.min(axis=1)))
    ((u, v),) = np.rint(D455.project(apply(inverse(CELL.T_base_camera_optical), places[[chosen]]))).astype(
        int
    )
    example = (sys.executable, "examples/4_pick_at_pixel.py")
    for outside in ((5000, 240), (-5, 240)):
        out = run(*example, *outside, domain=suite.domain_id, code=1)
        assert f"pixel {outside} is outside of the image" in out
    out = run(*example, u, v, domain=suite.domain_id)
    assert out.startswith(("0: ", "219: ", "220: ")), "it was picked, or slipped"
    after = suite.client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]
    others = [k for k in range(len(places)) if k != chosen]
    assert [after.places[k] for k in others] == [state.places[k] for k in others]

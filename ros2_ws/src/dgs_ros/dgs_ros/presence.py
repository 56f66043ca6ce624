"""Who is there: which server answers a name, and whether the client of a goal still lives.

All of it is what discovery knows. A process that was killed is gone from there after the lease of
`config/fastdds.xml`, which Fast DDS renews in threads of its own, however busy Python is. On an overloaded machine a
lease may run out all the same; then the next announcement brings the process back, with the identity that it had.
"""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Callable

from rclpy.node import Node
from unique_identifier_msgs.msg import UUID

_PERIOD = 0.1
"""Discovery is asked no more often [s]."""
GRACE = 0.5
"""Who is missing for so long has gone [s]: longer than announcements are apart; lease and grace together are 2 s."""
_SIGNATURE = 8
"""Bytes of a goal's identity that tell whose it is; the other eight are random."""


class Watch:
    """Remembers who was there, and says when somebody of them is missing."""

    def __init__(self, there: Callable[[], set[bytes]]):
        """`there`: identities of those who are there now."""
        self._there = there
        self._remembered = there()
        self._looked, self._missing_since = time.monotonic(), math.inf
        self._lost = False

    def lost(self) -> bool:
        """Whether one of those who were there at first has gone since, also if somebody else took its place."""
        if not self._lost and time.monotonic() - self._looked > _PERIOD:
            self._looked, now = time.monotonic(), self._there()
            self._remembered = self._remembered or now
            all_there = self._remembered <= now
            self._missing_since = math.inf if all_there else min(self._missing_since, self._looked)
            self._lost = self._looked - self._missing_since > GRACE
        return self._lost


def watch_server(node: Node, name: str) -> Watch:
    """Of the server of a service or an action: a server that was killed and started again is another one."""
    service = node.resolve_service_name(name)

    def there() -> set[bytes]:
        actions = node.get_publishers_info_by_topic(f"{name}/_action/status")
        services = node.get_publishers_info_by_topic(f"rr{service}Reply", no_mangle=True)  # as DDS calls it
        return {bytes(info.endpoint_gid) for info in (*actions, *services)}

    return Watch(there)


def watch_publisher(node: Node, topic: str) -> Watch:
    """Of those who publish on a topic."""
    return Watch(lambda: {bytes(info.endpoint_gid) for info in node.get_publishers_info_by_topic(topic)})


def signed_goal_id(node: Node) -> UUID:
    """A new identity for a goal by which `watch_client` finds the node that has sent it."""
    return UUID(uuid=[*_signature(node.get_name(), node.get_namespace()), *os.urandom(16 - _SIGNATURE)])


def watch_client(node: Node, action: str, goal_id: UUID) -> Watch:
    """Of the client that has sent a goal, if it signed the goal; the client of another one is never lost."""
    signature = bytes(goal_id.uuid)[:_SIGNATURE]

    def there() -> set[bytes]:
        clients = node.get_subscriptions_info_by_topic(f"{action}/_action/feedback")
        signed = [info for info in clients if _signature(info.node_name, info.node_namespace) == signature]
        return {bytes(info.endpoint_gid) for info in signed}

    return Watch(there)


def _signature(name: str, namespace: str) -> bytes:
    return hashlib.blake2b(f"{namespace.rstrip('/')}/{name}".encode(), digest_size=_SIGNATURE).digest()

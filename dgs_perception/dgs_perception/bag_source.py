"""Replays clouds or depth images of a rosbag2 (sqlite3 or mcap), without an installed ROS, through rosbags."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from dgs_description.errors import DgsError, ErrorCode

CLOUD = "sensor_msgs/msg/PointCloud2"
IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
PREFERRED_CLOUD_TOPIC = "/dgs/cloud"
SINGLE_MESSAGE_PERIOD = 0.1
"""Pause between two loops of a bag with only one message [s]."""


@dataclass(frozen=True)
class BagMessage:
    """One message of the bag.

    Attributes:
        topic, type: as recorded, e.g. `sensor_msgs/msg/PointCloud2`.
        time_ns: when it was recorded [ns].
        content: object with the fields of the ROS message; arrays are numpy arrays.
    """

    topic: str
    type: str
    time_ns: int
    content: Any


class BagSource:
    """The cloud topic of a bag, or its depth and camera info topics.

    Attributes:
        topic: the cloud or depth topic that is replayed.
        info_topic: the camera info topic, or None when clouds are replayed.
    """

    def __init__(self, path: Path | str, topic: str = "") -> None:
        """Open the bag and choose the topics.

        Args:
            path: folder of the bag, or a single .db3 or .mcap file.
            topic: PointCloud2 topic or depth image topic. Empty: `/dgs/cloud`, else the bag's only cloud topic, else
                its only image topic with "depth" in its name. The camera info topic of a depth topic is the one beside
                it, as camera drivers name them.

        Raises:
            DgsError: BAG_MISSING when there is no readable bag, BAG_TOPIC when it has no such topics, or several and
                none was named, or no messages on them; the sentence lists what the bag holds.
        """
        self.path = Path(path)
        try:
            self._reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except Exception as error:  # rosbags lets errors of SQLite, YAML and struct through
            raise DgsError(
                ErrorCode.BAG_MISSING, f"No bag can be read at {self.path}: {error or type(error).__name__}"
            ) from error
        try:
            self._choose(topic)
        except BaseException:
            self.close()
            raise

    def _choose(self, topic: str) -> None:
        connection = self._find(topic, (CLOUD, IMAGE)) if topic else self._find_unnamed()
        self.topic, self.info_topic = connection.topic, None
        self._connections = [connection]
        if connection.msgtype == IMAGE:
            info = self._find(f"{connection.topic.rpartition('/')[0]}/camera_info", (CAMERA_INFO,))
            self.info_topic = info.topic
            self._connections.append(info)
        for chosen in self._connections:
            if chosen.msgcount == 0:
                raise self._topic_error(f"holds no messages on {chosen.topic}")

    def _find(self, topic: str, types: tuple[str, ...]) -> Connection:
        for connection in self._reader.connections:
            if connection.topic == topic:
                if connection.msgtype in types:
                    return connection
                raise self._topic_error(f"has {connection.msgtype} on {topic}, not {' or '.join(types)}")
        raise self._topic_error(f"has no topic {topic} ({' or '.join(types)})")

    def _find_unnamed(self) -> Connection:
        clouds = [c for c in self._reader.connections if c.msgtype == CLOUD]
        preferred = [c for c in clouds if c.topic == PREFERRED_CLOUD_TOPIC]
        images = [c for c in self._reader.connections if c.msgtype == IMAGE and "depth" in c.topic]
        candidates = preferred or clouds or images
        if len(candidates) == 1:
            return candidates[0]
        if not candidates:
            raise self._topic_error("has neither a PointCloud2 nor a depth image topic")
        raise self._topic_error("has several topics that would do; name one")

    def _topic_error(self, what: str) -> DgsError:
        held = ", ".join(sorted(f"{c.topic} [{c.msgtype}, {c.msgcount}]" for c in self._reader.connections))
        return DgsError(ErrorCode.BAG_TOPIC, f"The bag {self.path} {what}. It holds: {held or 'nothing'}.")

    def messages(self) -> Iterator[BagMessage]:
        """One pass through the bag in recorded order; of a depth bag, a camera info always comes first.

        Raises:
            DgsError: BAG_MISSING when the bag turns out to be damaged.
        """
        try:
            if self.info_topic is not None:
                yield self._decode(*next(self._reader.messages(self._connections[1:])))
            for connection, time_ns, data in self._reader.messages(self._connections):
                yield self._decode(connection, time_ns, data)
        except DgsError:
            raise
        except Exception as error:
            raise DgsError(ErrorCode.BAG_MISSING, f"The bag {self.path} is damaged: {error}") from error

    def _decode(self, connection: Connection, time_ns: int, data: bytes) -> BagMessage:
        content = self._reader.deserialize(data, connection.msgtype)
        return BagMessage(connection.topic, connection.msgtype, time_ns, content)

    def replay(self, stop: threading.Event, rate: float = 1.0, loop: bool = True) -> Iterator[BagMessage]:
        """The messages at the pace they were recorded.

        Args:
            stop: ends the replay at once when set, also during a pause.
            rate: factor on the pace; 2 is twice as fast.
            loop: start again at the end, one mean period after the last message.

        Raises:
            DgsError: BAG_MISSING as `messages`.
        """
        while not stop.is_set():
            started, first, last, count = time.monotonic(), 0, 0, 0
            for message in self.messages():
                first = first if count else message.time_ns
                last = max(last, message.time_ns)
                count += message.topic == self.topic
                if stop.wait(max(0.0, started + (message.time_ns - first) * 1e-9 / rate - time.monotonic())):
                    return
                yield message
            if not loop:
                return
            period = (
                (last - first) * 1e-9 / (count - 1) if count > 1 and last > first else SINGLE_MESSAGE_PERIOD
            )
            stop.wait(period / rate)

    def close(self) -> None:
        """Close the bag; harmless when it is closed."""
        if self._reader.stack is not None:
            self._reader.close()

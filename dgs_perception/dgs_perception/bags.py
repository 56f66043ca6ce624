"""Reads and writes rosbag2 bags (sqlite3 or mcap) of clouds or depth images, without an installed ROS, by rosbags."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal

from backports import zstd
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Connection,
    Nodetype,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from dgs_description.errors import DgsError, ErrorCode

logger = logging.getLogger(__name__)
CLOUD = "sensor_msgs/msg/PointCloud2"
IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
PREFERRED_CLOUD_TOPIC = "/dgs/cloud"
SINGLE_MESSAGE_PERIOD = 0.1
"""Pause between two loops of a bag with only one message [s]."""
STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
COMPRESSION = {"sqlite3": CompressionMode.MESSAGE, "mcap": CompressionMode.STORAGE}
_PACKED = b"\x28\xb5\x2f\xfd"
"""Begins what Zstandard has packed; CDR begins otherwise."""
BAG_VERSION: Literal[9] = 9
"""Version of metadata.yaml that Jazzy writes."""
FOREVER = QosTime(2147483647, 4294967295)


def _qos(depth: int, reliability: QosReliability, durability: QosDurability) -> Qos:
    history, lively = QosHistory.KEEP_LAST, QosLiveliness.AUTOMATIC
    return Qos(history, depth, reliability, durability, FOREVER, FOREVER, lively, FOREVER, False)


SENSOR_DATA = _qos(5, QosReliability.BEST_EFFORT, QosDurability.VOLATILE)
RELIABLE = _qos(100, QosReliability.RELIABLE, QosDurability.VOLATILE)
LATCHED = _qos(1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL)
COMMIT_PERIOD = 1.0
"""A process that is killed loses no more than what came within so long [s]."""


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
            topic: of clouds or depth images. Empty: `/dgs/cloud`, else the bag's only cloud topic, else its only image
                topic with "depth" in its name. The camera info topic of a depth topic is the one beside it.

        Raises:
            DgsError: BAG_MISSING when there is no readable bag, BAG_TOPIC when it has no such topics, or several and
                none was named, or no messages on them; the sentence lists what the bag holds.
        """
        self.path = Path(path).expanduser()
        try:
            self._reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            self._reader.open()
        except Exception as error:  # rosbags lets errors of SQLite, YAML and struct through
            why = str(error) or type(error).__name__
            raise DgsError(ErrorCode.BAG_MISSING, f"No bag can be read at {self.path}: {why}") from error
        try:
            if not self._reader.is2:
                convert = f"rosbags-convert --src {self.path} --dst FOLDER --dst-typestore ros2_jazzy"
                raise DgsError(ErrorCode.BAG_MISSING, f"{self.path} is a bag of ROS 1; convert it: {convert}")
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
        """One pass in recorded order; of a depth bag, a camera info first. A damaged message is left out.

        Raises:
            DgsError: BAG_MISSING: the bag cannot be read any further.
        """
        try:
            stored: Iterator[Any] = self._reader.messages(self._connections)
            if self.info_topic is not None:
                stored = chain(islice(self._reader.messages(self._connections[1:]), 1), stored)
            sound = False
            for connection, time_ns, data in stored:
                try:
                    # Only metadata.yaml says so, which a killed recorder has not written.
                    plain = zstd.decompress(data) if data[:4] == _PACKED else data
                    content = self._reader.deserialize(plain, connection.msgtype)
                except Exception as error:  # whatever bytes that are none of the type lead to
                    logger.warning("%s: a damaged message on %s: %r", self.path, connection.topic, error)
                    continue
                sound |= connection.topic == self.topic
                yield BagMessage(connection.topic, connection.msgtype, time_ns, content)
            if not sound:
                raise ValueError(f"none of its messages on {self.topic} can be read")
        except Exception as error:
            raise DgsError(ErrorCode.BAG_MISSING, f"The bag {self.path} is damaged: {error}") from error

    def replay(self, stop: threading.Event, rate: float = 1.0, loop: bool = True) -> Iterator[BagMessage]:
        """The messages at the pace they were recorded.

        Args:
            stop: ends the replay at once when set, also during a pause.
            rate: factor on the pace; 2 is twice as fast.
            loop: start again at the end, one mean period after the last message.
        """
        while not stop.is_set():
            started, first, last, count = time.monotonic(), 0, 0, 0
            for message in self.messages():
                first = first if count else message.time_ns
                last = message.time_ns
                count += message.topic == self.topic
                if stop.wait(started + (message.time_ns - first) * 1e-9 / rate - time.monotonic()):
                    return
                yield message
            if not loop:
                return
            several = count > 1 and last > first
            period = (last - first) * 1e-9 / (count - 1) if several else SINGLE_MESSAGE_PERIOD
            stop.wait(period / rate)

    def close(self) -> None:
        """Close the bag; harmless when it is closed."""
        if self._reader.stack is not None:
            self._reader.close()


class BagWriter:
    """A new bag.

    `close` completes index and metadata.yaml, so that the bag opens; call it whatever happens. With "sqlite3" a killed
    process leaves all but the last second in the .db3, without metadata.yaml (`ros2 bag reindex` writes one; the camera
    node reads the .db3 itself).

    To be used in the thread that made it: SQLite insists.
    """

    def __init__(self, path: Path | str, storage: str = "sqlite3", compress: bool = False) -> None:
        """Create the bag's folder.

        Args:
            path: the folder; it must not exist yet.
            storage: one of `STORAGES`.
            compress: pack with Zstandard, the way either storage has for it.

        Raises:
            DgsError: BAG_MISSING: the folder exists, cannot be created, or has a name that sqlite3 misreads.
        """
        self.path = Path(path).expanduser()
        self.count = 0
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[tuple[str, str], Connection] = {}
        self._open = False
        self._committed = time.monotonic()
        # rosbags makes a URI of it, and writes elsewhere.
        if storage == "sqlite3" and set("#?%") & set(str(self.path)):
            raise self._error("has one of # ? % in its path: name another, or take the storage mcap")
        try:
            self._writer = Writer(self.path, version=BAG_VERSION, storage_plugin=STORAGES[storage])
            if compress:
                self._writer.set_compression(COMPRESSION[storage], CompressionFormat.ZSTD)
            self._writer.open()
        except Exception as error:  # WriterError, OSError, sqlite3.Error
            raise self._error(f"cannot be created: {error}") from error
        self._open = True

    def knows(self, message_type: str) -> bool:
        """Whether messages of a type can be written: those of ROS itself, and what was `define`d."""
        return message_type in self._types.fielddefs

    def define(self, message_type: str, text: str) -> list[str]:
        """Learn a type from the text of its .msg file; returns the types it is made of that are not known yet."""
        found = get_types_from_msg(text, message_type)
        self._types.register(found)
        fields = [kind for _, definitions in found.values() for _, kind in definitions]
        return [name for name in map(_element, fields) if name and not self.knows(name)]

    def write(self, topic: str, message_type: str, data: bytes, time_ns: int, qos: Qos = SENSOR_DATA) -> None:
        """Append a message of a type such as `sensor_msgs/msg/PointCloud2`.

        Args:
            data: CDR, as a raw subscription of rclpy gives it.
            time_ns: when it was received [ns].
            qos: with which the topic is played; RViz, for one, hears no transforms that are not RELIABLE.

        Raises:
            DgsError: BAG_MISSING when the disk does not take it, or the bag is closed.
        """
        if not self._open:
            raise self._error("is closed; nothing more can be written to it.")
        try:
            self._writer.write(self._connection(topic, message_type, qos), time_ns, data)
            self._commit()
        except Exception as error:
            raise self._error(f"cannot be written: {error}") from error
        self.count += 1

    def _error(self, what: str) -> DgsError:
        return DgsError(ErrorCode.BAG_MISSING, f"The bag {self.path} {what}")

    def _commit(self) -> None:
        """End SQLite's transaction now and then: rosbags would do so at the end only, and a kill would lose it all."""
        database = getattr(self._writer.storage, "conn", None)
        if database is not None and time.monotonic() - self._committed > COMMIT_PERIOD:
            database.commit()
            self._committed = time.monotonic()

    def _connection(self, topic: str, message_type: str, qos: Qos) -> Connection:
        key = topic, message_type
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                topic, message_type, typestore=self._types, offered_qos_profiles=[qos]
            )
        return self._connections[key]

    def close(self) -> None:
        """Complete index and metadata; harmless when closed. Raises DgsError BAG_MISSING if the disk is full."""
        if not self._open:
            return
        self._open = False
        try:
            self._writer.close()
        except Exception as error:
            with suppress(Exception):
                self._writer.abort()
            raise self._error(f"cannot be completed: {error}") from error


def _element(field: Any) -> str:
    """Name of the message type that a field of rosbags holds, alone or in a list; "" for a number or a text."""
    kind, value = field
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _element(value[0])
    return str(value) if kind == Nodetype.NAME else ""

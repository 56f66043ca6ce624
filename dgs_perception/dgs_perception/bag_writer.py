"""Writes clouds to a rosbag2 folder (sqlite3 or mcap), without an installed ROS, through rosbags."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Literal

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dgs_description.errors import DgsError, ErrorCode

STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
COMPRESSION = {"sqlite3": CompressionMode.MESSAGE, "mcap": CompressionMode.STORAGE}
BAG_VERSION: Literal[9] = 9
"""Version of metadata.yaml that Jazzy writes."""
FOREVER = QosTime(2147483647, 4294967295)
SENSOR_DATA = Qos(
    QosHistory.KEEP_LAST,
    5,
    QosReliability.BEST_EFFORT,
    QosDurability.VOLATILE,
    FOREVER,
    FOREVER,
    QosLiveliness.AUTOMATIC,
    FOREVER,
    False,
)
COMMIT_PERIOD = 1.0
"""A process that is killed loses no more than what came within so long [s]."""


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
            storage: "sqlite3" or "mcap".
            compress: pack with Zstandard, the way either storage has for it.

        Raises:
            ValueError: `storage` is neither "sqlite3" nor "mcap".
            DgsError: BAG_MISSING when the folder exists already or cannot be created.
        """
        if storage not in STORAGES:
            raise ValueError(f"The storage must be one of {', '.join(STORAGES)}, not {storage!r}.")
        self.path = Path(path)
        self.count = 0
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[tuple[str, str], Connection] = {}
        self._open = False
        self._committed = time.monotonic()
        try:
            self._writer = Writer(self.path, version=BAG_VERSION, storage_plugin=STORAGES[storage])
            if compress:
                self._writer.set_compression(COMPRESSION[storage], CompressionFormat.ZSTD)
            self._writer.open()
        except Exception as error:  # WriterError, OSError, sqlite3.Error
            raise DgsError(
                ErrorCode.BAG_MISSING, f"The bag {self.path} cannot be created: {error}"
            ) from error
        self._open = True

    def write(self, topic: str, message_type: str, data: bytes, time_ns: int) -> None:
        """Append a message as it came over the wire.

        Args:
            topic: its topic.
            message_type: e.g. `sensor_msgs/msg/PointCloud2`.
            data: CDR, as a raw subscription of rclpy gives it.
            time_ns: when it was received [ns].

        Raises:
            DgsError: BAG_MISSING when the disk does not take it, or the bag is closed.
        """
        if not self._open:
            raise DgsError(
                ErrorCode.BAG_MISSING, f"The bag {self.path} is closed; nothing more can be written to it."
            )
        try:
            self._writer.write(self._connection(topic, message_type), time_ns, data)
            self._commit()
        except Exception as error:
            raise DgsError(
                ErrorCode.BAG_MISSING, f"The bag {self.path} cannot be written: {error}"
            ) from error
        self.count += 1

    def _commit(self) -> None:
        """End SQLite's transaction now and then: rosbags would do so at the end only, and a kill would lose it all."""
        database = getattr(self._writer.storage, "conn", None)
        if database is not None and time.monotonic() - self._committed > COMMIT_PERIOD:
            database.commit()
            self._committed = time.monotonic()

    def _connection(self, topic: str, message_type: str) -> Connection:
        key = topic, message_type
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(
                topic, message_type, typestore=self._types, offered_qos_profiles=[SENSOR_DATA]
            )
        return self._connections[key]

    def close(self) -> None:
        """Complete index and metadata; harmless when closed.

        Raises:
            DgsError: BAG_MISSING when the disk does not take them.
        """
        if not self._open:
            return
        self._open = False
        try:
            self._writer.close()
        except Exception as error:
            with suppress(Exception):
                self._writer.abort()
            raise DgsError(
                ErrorCode.BAG_MISSING, f"The bag {self.path} cannot be completed: {error}"
            ) from error

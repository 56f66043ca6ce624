"""Records the clouds of a topic to a rosbag2 folder until it is stopped or has enough."""

from __future__ import annotations

import os
import queue
import signal
import time
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2

from dgs_description.errors import DgsError
from dgs_description.parameters import parameter
from dgs_perception.bags import CLOUD, STORAGES, BagWriter
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.run import run

WAITING_CLOUDS = 30
"""Clouds that may wait for the disk before newer ones are dropped."""
DRAIN_TIME = 1.5
"""After a stop, clouds that wait are still written for so long [s]."""


@dataclass(frozen=True)
class RecorderParameters:
    """What to record, and where to."""

    path: str = parameter("", "Folder of the new bag; it must not exist yet.")
    topic: str = parameter("/dgs/cloud", "PointCloud2 topic that is recorded.")
    storage: str = parameter("sqlite3", "Storage of the bag.", choices=tuple(STORAGES))
    compress: bool = parameter(False, "Pack the bag with Zstandard; smaller, but slower to write.")
    period: float = parameter(0.0, "Least time between two recorded clouds; 0 = record all [s].", 0.0, 3600.0)
    max_clouds: int = parameter(0, "End after so many clouds; 0 = until stopped.", 0, 1_000_000)

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError("the parameter 'path' must name the folder of the new bag")


class CloudRecorderNode(DgsNode[RecorderParameters]):
    """One raw subscription, and a thread that writes."""

    def __init__(self, **node_arguments: Any) -> None:
        """Create the bag and subscribe. Raises DgsError PARAMETER_INVALID; BAG_MISSING: the bag cannot be created."""
        super().__init__("cloud_recorder", RecorderParameters, **node_arguments)
        # One thread makes, fills and closes the bag: SQLite wants it so, and callbacks must not wait for disks.
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="writer")
        p = self.parameters
        self._writer = self._worker.submit(BagWriter, p.path, p.storage, p.compress).result()
        self._waiting: queue.Queue[tuple[bytes, int]] = queue.Queue(WAITING_CLOUDS)
        self._dropped = 0
        self._next_due = 0.0
        self._writing = self._worker.submit(self._write_all)
        qos, own = qos_profile_sensor_data, MutuallyExclusiveCallbackGroup()
        self.create_subscription(PointCloud2, p.topic, self._on_cloud, qos, raw=True, callback_group=own)
        self.report(Level.OK, f"Waiting for {p.topic}.", clouds=0, dropped=0)

    def close(self) -> None:
        """Wait until the bag is complete."""
        wait([self._writing], timeout=DRAIN_TIME + 1.0)

    def _on_cloud(self, data: bytes) -> None:
        now = time.monotonic()
        if now < self._next_due:
            return
        self._next_due = now + self.parameters.period
        try:
            self._waiting.put_nowait((data, self.get_clock().now().nanoseconds))
        except queue.Full:
            self._dropped += 1

    def _write_all(self) -> None:
        try:
            with closing(self._writer):
                self._write_until_done()
        except DgsError as error:
            self.get_logger().error(f"{error.message} (code {int(error.code)})")
            self.report(Level.ERROR, error.message, error_code=int(error.code), clouds=self._writer.count)
            return
        self.get_logger().info(f"{self._writer.count} clouds in {self._writer.path}, {self._dropped} dropped")
        if not self.stopping.is_set():
            os.kill(os.getpid(), signal.SIGINT)  # enough clouds: end the way Ctrl-C does

    def _write_until_done(self) -> None:
        stop_at = float("inf")
        while time.monotonic() < stop_at:
            if self.stopping.is_set():
                stop_at = min(stop_at, time.monotonic() + DRAIN_TIME)
            try:
                data, time_ns = self._waiting.get(timeout=0.1)
            except queue.Empty:
                if self.stopping.is_set():
                    return
                continue
            self._writer.write(self.parameters.topic, CLOUD, data, time_ns)
            self._report_progress()
            if self._writer.count == self.parameters.max_clouds:
                return

    def _report_progress(self) -> None:
        message = f"Recording {self.parameters.topic} to {self._writer.path}."
        level = Level.WARN if self._dropped else Level.OK
        self.report(level, message, clouds=self._writer.count, dropped=self._dropped)


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_perception cloud_recorder`."""
    run(CloudRecorderNode, args)

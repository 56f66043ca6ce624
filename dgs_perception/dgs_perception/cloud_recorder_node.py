"""Records topics to a rosbag2 folder until it is stopped or has enough: the clouds, or all of a run."""

from __future__ import annotations

import os
import queue
import signal
import time
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.interfaces import Qos

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import parameter
from dgs_perception.bags import LATCHED, RELIABLE, SENSOR_DATA, STORAGES, BagWriter
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.run import run

WAITING_MESSAGES = 500
"""Messages that may wait for the disk before newer ones are dropped."""
DRAIN_TIME = 1.5
"""After a stop, messages that wait are still written for so long [s]."""
LOOK_PERIOD = 0.5
"""Topics that nobody publishes yet are looked for so often [s]."""
CLOCK_PATIENCE = 5.0
"""With use_sim_time the first /clock is waited for so long [s]."""
RUN = (
    "/robot_description",
    "/tf",
    "/tf_static",
    "/joint_states",
    "/dexhand/joint_states",
    "/dgs/cloud",
    "/dgs/grasps",
    "/dgs/grasp_markers",
    "/dgs/pick_plan",
    "/camera/camera/color/image_raw",
    "/camera/camera/depth/camera_info",
    "/diagnostics",
)
"""What RViz, Foxglove and the planner need to replay a run."""


@dataclass(frozen=True)
class RecorderParameters:
    """What to record, and where to."""

    path: str = parameter("", "Folder of the new bag; it must not exist yet.")
    topics: tuple[str, ...] = parameter(("/dgs/cloud",), "Topics to record; [run] = all that a replay needs.")
    storage: str = parameter("sqlite3", "Storage of the bag.", choices=tuple(STORAGES))
    compress: bool = parameter(False, "Pack the bag with Zstandard; smaller, but slower to write.")
    period: float = parameter(
        0.0, "Least time between two messages of a topic, as the bag has it; 0 = record all [s].", 0.0, 3600.0
    )
    max_messages: int = parameter(0, "End after so many messages; 0 = until stopped.", 0, 1_000_000_000)

    def __post_init__(self) -> None:
        if not self.path:
            raise ValueError("the parameter 'path' must name the folder of the new bag")


class CloudRecorderNode(DgsNode[RecorderParameters]):
    """Raw subscriptions, and a thread that writes."""

    def __init__(self, **node_arguments: Any) -> None:
        """Create the bag and subscribe. Raises DgsError PARAMETER_INVALID; BAG_MISSING: the bag cannot be created."""
        super().__init__("cloud_recorder", RecorderParameters, **node_arguments)
        # One thread makes, fills and closes the bag: SQLite wants it so, and callbacks must not wait for disks.
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="writer")
        p = self.parameters
        self._writer = self._worker.submit(BagWriter, p.path, p.storage, p.compress).result()
        # What `BagWriter.write` takes of each message: topic, type, CDR, time of arrival, QoS.
        self._waiting: queue.Queue[tuple[str, str, bytes, int, Qos]] = queue.Queue(WAITING_MESSAGES)
        self._dropped = 0
        self._system_time = False
        self._started = time.monotonic()
        self._kept: dict[str, int] = {}
        named = [topic for name in p.topics for topic in (RUN if name == "run" else (name,))]
        self._wanted = list(dict.fromkeys(named))
        self._writing = self._worker.submit(self._write_all)
        self._look_for_topics()
        self.every(LOOK_PERIOD, self._look_for_topics)
        self.report(Level.OK, f"Waiting for {', '.join(self._wanted)}.", messages=0, dropped=0)

    def close(self) -> None:
        """Wait until the bag is complete."""
        wait([self._writing], timeout=DRAIN_TIME + 1.0)

    def _look_for_topics(self) -> None:
        """Subscribe to the wanted topics that somebody publishes by now, as they are published."""
        if not self._time_is_known():
            return
        for topic in list(self._wanted):
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            self._wanted.remove(topic)
            offered, name = [each.qos_profile for each in publishers], publishers[0].topic_type
            kept = any(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
            # Drivers of cameras leave the durability to the middleware, which may keep the last image.
            latched = kept and "sensor_msgs" not in name
            # One that offers less would not be heard.
            reliable = latched or all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
            qos = QoSProfile(
                depth=100,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            )
            package, folder, kind = name.split("/")
            message_class = None
            with suppress(ImportError):
                message_class = getattr(import_module(f"{package}.{folder}"), kind, None)
            if message_class is None or folder != "msg":  # not installed, or feedback of an action
                self.get_logger().warning(
                    f"{topic} is left out: {name} is no message type that a bag can hold"
                )
                continue
            replayed = LATCHED if latched else RELIABLE if reliable else SENSOR_DATA
            keep = partial(self._keep, topic, name, replayed)
            self.create_subscription(message_class, topic, keep, qos, raw=True)

    def _keep(self, topic: str, message_type: str, qos: Qos, data: bytes) -> None:
        now = self._now()
        since = now - self._kept.get(topic, now + 1)  # less than 0 also after a simulation's new start
        too_soon = 0 <= since < self.parameters.period * 1e9
        if self._writing.done() or (too_soon and qos is not LATCHED):
            return
        self._kept[topic] = now
        try:
            self._waiting.put_nowait((topic, message_type, data, now, qos))
        except queue.Full:
            self._dropped += 1

    def _time_is_known(self) -> bool:
        """Whether messages can be stamped: all by one clock, or the bag would last for decades."""
        if self._system_time or self.get_clock().now().nanoseconds:
            return True
        self._system_time = time.monotonic() - self._started > CLOCK_PATIENCE
        if self._system_time:
            self.get_logger().warning(
                "nobody publishes /clock: messages get the system's time (use_sim_time is for a simulation)"
            )
        return self._system_time

    def _now(self) -> int:
        """Time of arrival [ns]."""
        return time.time_ns() if self._system_time else int(self.get_clock().now().nanoseconds)

    def _write_all(self) -> None:
        try:
            with closing(self._writer):
                self._write_until_done()
        except Exception as problem:
            unknown = DgsError(
                ErrorCode.BAG_MISSING, f"The bag {self._writer.path} cannot go on: {problem!r}"
            )
            error = problem if isinstance(problem, DgsError) else unknown
            self.get_logger().error(f"{error.message} (code {int(error.code)})")
            self.report(Level.ERROR, error.message, code=int(error.code), messages=self._writer.count)
            self._waiting.queue.clear()
            return
        if self.stopping.is_set():
            self._dropped += self._waiting.qsize()
        self.get_logger().info(
            f"{self._writer.count} messages in {self._writer.path}, {self._dropped} dropped"
        )
        if self._wanted:
            self.get_logger().warning(f"nobody published on {', '.join(self._wanted)}")
        if not self.stopping.is_set():
            os.kill(os.getpid(), signal.SIGINT)  # enough: end the way Ctrl-C does

    def _write_until_done(self) -> None:
        stop_at = float("inf")
        while time.monotonic() < stop_at:
            if self.stopping.is_set():
                stop_at = min(stop_at, time.monotonic() + DRAIN_TIME)
            try:
                message = self._waiting.get(timeout=0.1)
            except queue.Empty:
                if self.stopping.is_set():
                    return
                continue
            _define(self._writer, message[1])
            self._writer.write(*message)
            self._report_progress()
            if self._writer.count == self.parameters.max_messages:
                return

    def _report_progress(self) -> None:
        level = Level.WARN if self._dropped else Level.OK
        message = f"Recording to {self._writer.path}."
        self.report(level, message, messages=self._writer.count, dropped=self._dropped)


def _define(writer: BagWriter, message_type: str) -> None:
    """Teach the writer a type, and what it is made of, from the files that its package has installed."""
    unknown = [] if writer.knows(message_type) else [message_type]
    while unknown:
        name = unknown.pop()
        package, _, kind = name.split("/")
        file = Path(get_package_share_directory(package)) / "msg" / f"{kind}.msg"
        unknown += writer.define(name, file.read_text())


def main(args: list[str] | None = None) -> None:
    """Entry point of `ros2 run dgs_perception cloud_recorder`."""
    run(CloudRecorderNode, args)


if __name__ == "__main__":
    main()

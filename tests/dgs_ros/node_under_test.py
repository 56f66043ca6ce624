"""A node with every kind of parameter and work that does not end, for test_base_node.py."""

from __future__ import annotations

import ctypes
import logging
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from dgs_interfaces.action import ClearTable
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from std_srvs.srv import Trigger

import dgs_ros.run
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import parameter
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.run import run


@dataclass(frozen=True)
class WorkParameters:
    """Parameters of the node."""

    work: str = parameter(
        "none",
        "What the node is busy with.",
        choices=(
            "none",
            "callbacks",
            "thread",
            "stubborn",
            "raise",
            "refuse",
            "break",
            "half_built",
            "context",
            "stuck",
            "held",
            "locked_up",
            "memory",
        ),
    )
    rate: float = parameter(10.0, "Rate [Hz].", minimum=1.0, maximum=30.0)
    corner: tuple[float, float, float] = parameter((0.0, 0.0, 0.0), "A corner [m].")
    names: tuple[str, ...] = parameter((), "Names.")


def hold_the_lock() -> None:
    """Let no thread of Python go on for a minute."""
    ctypes.PyDLL(None).sleep(60)


class WorkNode(DgsNode[WorkParameters]):
    """Works as it is told to."""

    def __init__(self) -> None:
        super().__init__("work_node", WorkParameters)
        self.calls = 0
        self._server = ActionServer(
            self, ClearTable, "~/clear", execute_callback=lambda _: ClearTable.Result()
        )
        self.create_service(Trigger, "~/break", self._break)
        work = self.parameters.work
        if work == "break":
            raise RuntimeError("something broke")
        if work == "half_built":
            threading.Thread(target=time.sleep, args=(60,)).start()
            raise DgsError(ErrorCode.CAMERA_MISSING, "no camera")
        if work in ("thread", "stubborn"):
            self.thread = threading.Thread(target=self._loop)
            self.thread.start()
        if work == "memory":
            print(f"kept {self._kept_by_threads():.0f} MiB", flush=True)
        if work == "held":
            dgs_ros.run.HELD = 3.0
            self.create_timer(0.1, hold_the_lock)
        if work == "locked_up":  # as the kernel counts for a timer thread that waits for good
            dgs_ros.run.HELD = 3.0
            dgs_ros.run.timer_wakes = lambda pid: 100
        if work in ("callbacks", "raise", "context"):
            self.create_timer(0.1, self._callback, callback_group=ReentrantCallbackGroup())
        self.report(
            Level.WARN, "working", work=work, rate=self.parameters.rate, corner=self.parameters.corner
        )

    def prepare(self) -> None:
        """Warn as modules without ROS do."""
        if self.parameters.work == "thread":
            logging.getLogger("core").warning("the %s is lost", "connection")
            logging.getLogger("core").error("the connection is lost for good")

    def close(self) -> None:
        """Say that it was called; a stuck node holds Python's lock."""
        print("closing", flush=True)
        if self.parameters.work == "stuck":
            hold_the_lock()

    def destroy_node(self) -> None:
        """Say that the node was taken apart in good order."""
        super().destroy_node()
        print("destroyed", flush=True)

    def _loop(self) -> None:
        print("busy", flush=True)
        if self.parameters.work == "stubborn":
            time.sleep(60)
        self.stopping.wait()

    def _kept_by_threads(self) -> float:
        """What stays resident of 16 MiB that each of 24 threads had for a moment [MiB]."""

        def resident() -> float:
            return int(Path("/proc/self/statm").read_text().split()[1]) / 256

        def work() -> None:
            with one_by_one:
                np.ones(1 << 21)
            worked.wait()
            self.stopping.wait()

        np.ones(3 << 20)  # glibc takes blocks of the size of one that was freed from its heaps
        one_by_one, worked = threading.Lock(), threading.Barrier(25)
        before = resident()
        for _ in range(24):
            threading.Thread(target=work, daemon=True).start()
        worked.wait()
        return resident() - before

    def _break(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "half done"
        raise RuntimeError("a service broke")

    def _callback(self) -> None:
        self.calls += 1
        if self.parameters.work == "raise":
            if self.calls == 1:
                raise RuntimeError("a callback broke")
            return
        if self.parameters.work == "context":
            self.context.shutdown()
        print("busy", flush=True)
        time.sleep(60)


if __name__ == "__main__":
    run(WorkNode)

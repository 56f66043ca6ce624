"""A node of the suite as a process of its own, started and stopped the way a user does it.

with suite_node("camera_node", ros_domain_id, tmp_path, {"source": "depth_topics"}) as camera:
    camera.wait_ready(lambda: client.count_publishers("/dgs/cloud") > 0, timeout=10.0)
    ...
    assert camera.interrupt() == 0
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from dgs_bringup.nodes import NODES
from tests.support.environment import GUARD, ros_environment


def group_members(group: int) -> list[int]:
    """Ids of the processes of a process group that still run; one that is dead but not yet collected does not."""
    members = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, process_group = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has ended meanwhile
            continue
        if int(process_group) == group and state not in "ZX":
            members.append(int(stat.parent.name))
    return members


END = 20.0
"""A node ends within 5 s of a signal on a quiet machine [s]."""


class NodeDied(AssertionError):
    """The node ended although it was expected to run."""


class NodeProcess:
    """`ros2 run PACKAGE EXECUTABLE` in its own process group, its output in a log file.

    A context manager: entering starts the node, leaving presses Ctrl-C, so that it gives its shared memory (64 MiB)
    back, and kills whatever still runs of its group after `END` seconds.
    """

    def __init__(
        self,
        package: str,
        executable: str,
        *,
        domain_id: int,
        log_file: Path,
        arguments: Sequence[str] = (),
        parameters: Mapping[str, Any] | None = None,
        params_file: Path | None = None,
        remappings: Mapping[str, str] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Describe the node; nothing is started yet.

        Args:
            package: ament package.
            executable: name of the executable in the package.
            domain_id: ROS_DOMAIN_ID, from the fixture `ros_domain_id`.
            log_file: receives stdout and stderr.
            arguments: the node's own arguments, before `--ros-args`.
            parameters: passed as `-p name:=value`; lists, strings, numbers and booleans.
            params_file: passed as `--params-file`.
            remappings: passed as `-r from:=to`, e.g. `{"__node": "left_camera"}`.
            environment: added to the environment of `setup_env.sh`.
        """
        self.name = f"{package}/{executable}"
        self.log_file = Path(log_file)
        self.command = ["ros2", "run", package, executable, *arguments, "--ros-args"]
        if params_file is not None:
            self.command += ["--params-file", str(params_file)]
        for key, value in (parameters or {}).items():  # of two that name a node the later one counts
            self.command += ["-p", f"{key}:={json.dumps(value)}"]
        for key, value in (remappings or {}).items():
            self.command += ["-r", f"{key}:={value}"]
        self.environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain_id), **(environment or {})}
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the node in a new process group."""
        if self._process is not None:
            raise RuntimeError(f"{self.name} was started before; make a new NodeProcess")
        self.log_file.parent.mkdir(parents=True, exist_ok=True)
        with self.log_file.open("wb") as log:
            self._process = subprocess.Popen(
                self.command,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The running or ended process."""
        if self._process is None:
            raise RuntimeError(f"{self.name} has not been started")
        return self._process

    @property
    def exit_code(self) -> int | None:
        """Exit code, or None while the node runs."""
        return self.process.poll()

    def log(self) -> str:
        """Everything the node has written so far."""
        return self.log_file.read_text(errors="replace") if self.log_file.exists() else ""

    def wait_ready(self, predicate: Callable[[], Any], timeout: float = GUARD, period: float = 0.05) -> None:
        """Wait until `predicate` says yes.

        Raises:
            NodeDied: the node ended meanwhile.
            TimeoutError: the predicate said no for `timeout` seconds, or for `GUARD` if that is longer.
        """
        timeout, start = max(timeout, GUARD), time.monotonic()
        while not predicate():
            if self.exit_code is not None:
                raise NodeDied(
                    f"{self.name} ended with exit code {self.exit_code} before it was ready\n{self._tail()}"
                )
            if time.monotonic() - start > timeout:
                raise TimeoutError(f"{self.name} was not ready within {timeout} s\n{self._tail()}")
            time.sleep(period)

    def wait_for_log(self, pattern: str, timeout: float = GUARD) -> re.Match[str]:
        """Wait until a line of the log matches the regular expression `pattern`; errors as in `wait_ready`."""
        self.wait_ready(lambda: re.search(pattern, self.log()), timeout)
        match = re.search(pattern, self.log())
        assert match is not None
        return match

    def interrupt(self) -> int:
        """Press Ctrl-C: SIGINT to the whole group; return the exit code.

        Raises:
            NodeDied: the node had ended before.
            TimeoutError: it still runs after `END` seconds.
        """
        if self.exit_code is not None:
            raise NodeDied(f"{self.name} had ended with exit code {self.exit_code}\n{self._tail()}")
        self.send_interrupt()
        return self.wait(END)

    def send_interrupt(self) -> None:
        """Press Ctrl-C and do not wait."""
        os.killpg(self.process.pid, signal.SIGINT)

    def wait(self, timeout: float = GUARD) -> int:
        """Wait for the node to end by itself; return the exit code. Raises TimeoutError."""
        try:
            return self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"{self.name} still runs after {timeout} s\n{self._tail()}") from None

    def kill(self) -> None:
        """Kill the whole group and wait until none of it runs; harmless when it has ended."""
        if self._process is None:
            return
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        self._process.wait()
        # The node itself is a child of `ros2 run` where that is the real command.
        while group_members(self._process.pid):
            time.sleep(0.01)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        if self.exit_code is None:
            with suppress(TimeoutError):
                self.interrupt()
        self.kill()

    def _tail(self, lines: int = 30) -> str:
        return "\n".join(["last lines of its log:", *self.log().splitlines()[-lines:]])


def suite_node(
    name: str, domain_id: int, folder: Path, parameters: Mapping[str, Any] | None = None, **others: Any
) -> NodeProcess:
    """A node of the suite by its name, which its log file in `folder` has too; the others as of `NodeProcess`."""
    (package,) = (node.package for node in NODES if node.name == name)
    log = folder / f"{name}.log"
    return NodeProcess(package, name, domain_id=domain_id, log_file=log, parameters=parameters, **others)

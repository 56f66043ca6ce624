"""The environment that nodes run in, and ROS domain ids that no two tests share at the same time."""

from __future__ import annotations

import fcntl
import functools
import itertools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

REPO_ROOT = Path(__file__).resolve().parents[2]
SETUP_SCRIPT = REPO_ROOT / "ros2_ws" / "setup_env.sh"

# Fast DDS derives its ports from the domain id; from 102 on they reach into the range that Linux hands out by itself.
DOMAIN_IDS = range(1, 101)

GUARD = 120.0
"""What a test waits for may take so long [s]: it waits for conditions, and a busy machine is no failure."""

_steps = itertools.count()


@functools.cache
def ros_environment() -> MappingProxyType[str, str]:
    """Return the variables that `source ros2_ws/setup_env.sh` leaves behind, read once per test session.

    Raises:
        RuntimeError: the script fails, for example because nothing has been built yet.
    """
    result = subprocess.run(
        ["bash", "-c", 'source "$1" >&2 && env -0', "bash", str(SETUP_SCRIPT)],
        capture_output=True,
        check=False,
    )
    if result.returncode != 0:
        raise RuntimeError(f"sourcing {SETUP_SCRIPT} failed; run `make setup`:\n{result.stderr.decode()}")
    pairs = (entry.split("=", 1) for entry in result.stdout.decode().split("\0") if "=" in entry)
    return MappingProxyType(dict(pairs))


def run(*command: object, domain: int = 0, code: int = 0, cwd: Path = REPO_ROOT) -> str:
    """Output of a command, in the checkout's root; with its errors if its exit code must be another than 0."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=cwd,
        env={**ros_environment(), "ROS_DOMAIN_ID": str(domain)},
        capture_output=True,
        text=True,
        timeout=4 * GUARD,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + (done.stderr if code else "")


def end_tidily() -> None:
    """Let SIGTERM end this process as Ctrl-C does: with what it has started."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def reserved_domain_id() -> Iterator[int]:
    """Reserve a ROS domain id in 1..100 until the block ends, also against other test processes of this machine."""
    start = (os.getpid() * 13 + next(_steps)) % len(DOMAIN_IDS)
    folder = Path(tempfile.gettempdir()) / f"dgs_ros_domains_{os.getuid()}"
    folder.mkdir(exist_ok=True)
    for step in range(len(DOMAIN_IDS)):
        domain_id = DOMAIN_IDS[(start + step) % len(DOMAIN_IDS)]
        lines = Path("/proc/net/udp").read_text().splitlines()[1:]
        ports = {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
        if ports.intersection(range(7400 + 250 * domain_id, 7650 + 250 * domain_id)):
            continue  # a suite is there
        with (folder / f"{domain_id}.lock").open("w") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield domain_id
            return
    raise RuntimeError(
        f"all ROS domain ids {DOMAIN_IDS.start}..{DOMAIN_IDS.stop - 1} are in use by other tests"
    )


def wait_until(condition: Callable[[], Any], timeout: float = GUARD) -> None:
    """Until a condition holds; it must within `timeout` [s]."""
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def free_port() -> int:
    """A TCP port of the loopback that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def run_as(hand: str, file: Path) -> subprocess.CompletedProcess[str]:
    """Run a file of tests in a process of another hand, which is chosen once per process."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", str(file)]
    return subprocess.run(
        command,
        cwd=REPO_ROOT,
        env=os.environ | {"DGS_HAND": hand},
        capture_output=True,
        text=True,
        check=False,
    )

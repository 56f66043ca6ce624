"""start_suite.sh ends its nodes however it is ended itself; with nodes of a few lines in the place of the real ones."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

from dgs_bringup.ros_session import wait_until
from tests.support.environment import GUARD, REPO_ROOT
from tests.support.processes import group_members

NODE = """#!/bin/bash
echo $$ >>"$PIDS"
while true; do sleep 0.1; done
"""
COMMAND = 'trap "sleep 1; exit" TERM; touch "$PIDS.ready"; while true; do sleep 0.1; done'


def alone(folder: Path, python3: str) -> tuple[str, dict[str, str]]:
    """The script in a checkout that has nothing else, and an environment in which `python3` does what is given."""
    scripts = folder / "ros2_ws/src/dgs_bringup/scripts"
    scripts.mkdir(parents=True)
    script = shutil.copy(REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh", scripts)
    (folder / "ros2_ws/setup_env.sh").touch()
    for name, text in (("ros2", NODE), ("python3", f"#!/bin/bash\n{python3}\n")):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    path = f"{folder}:{os.environ['PATH']}"
    return str(script), os.environ | {"PATH": path, "PIDS": str(folder / "pids")}


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_while_the_command_ends_leaves_no_node(
    tmp_path: Path, ending: signal.Signals
) -> None:
    script, environment = alone(tmp_path, python3="")  # which waits until all are ready
    pids = tmp_path / "pids"
    words = ["--mode", "replay", "--bag", str(tmp_path), "--log", str(tmp_path), "--", "bash", "-c", COMMAND]
    suite = subprocess.Popen(["bash", script, *words], env=environment, start_new_session=True)
    try:
        assert wait_until((tmp_path / "pids.ready").exists, GUARD)
        for _ in range(2):  # a terminal that goes may tell it twice: by the kernel and by the shell
            suite.send_signal(ending)
            time.sleep(0.3)
        suite.wait(GUARD)
        nodes = [int(pid) for pid in pids.read_text().split()]
        assert len(nodes) == 2
        assert wait_until(lambda: not any(group_members(node) for node in nodes), 5.0)
    finally:
        suite.kill()
        for pid in pids.read_text().split():
            if group_members(int(pid)):
                os.killpg(int(pid), signal.SIGKILL)


@pytest.mark.parametrize("domain", ["abc", "999", "-1", "08"])
def test_a_domain_that_ros_does_not_have_is_refused(domain: str) -> None:
    script = REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh"
    environment = os.environ | {"ROS_DOMAIN_ID": domain}
    done = subprocess.run(["bash", script], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"ROS_DOMAIN_ID is a number from 0 to 232, not '{domain}'" in done.stderr


def test_whoever_is_in_the_domain_is_looked_at_before_anything_starts(
    tmp_path: Path, ros_domain_id: int
) -> None:
    script, environment = alone(tmp_path, python3='[[ $* == *"--mode replay --before" ]] && exit 1')
    words = ["--mode", "replay", "--bag", str(tmp_path), "--log", str(tmp_path / "logs")]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 7400 + 250 * ros_domain_id + 12))  # of the second program in a domain
        done = subprocess.run(
            ["bash", script, *words],
            env=environment | {"ROS_DOMAIN_ID": str(ros_domain_id)},
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 2 and "nothing was started" in done.stderr
    assert not (tmp_path / "pids").exists()

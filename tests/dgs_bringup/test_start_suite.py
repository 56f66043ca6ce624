"""start_suite.sh ends its nodes however it is ended itself; with nodes of a few lines in the place of the real ones."""

from __future__ import annotations

import os
import shutil
import signal
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


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_while_the_command_ends_leaves_no_node(
    tmp_path: Path, ending: signal.Signals
) -> None:
    scripts = tmp_path / "ros2_ws/src/dgs_bringup/scripts"
    scripts.mkdir(parents=True)
    script = shutil.copy(REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh", scripts)
    (tmp_path / "ros2_ws/setup_env.sh").touch()
    for name, text in (("ros2", NODE), ("python3", "#!/bin/bash\n")):  # the latter waits until all are ready
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    pids = tmp_path / "pids"
    environment = os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PIDS": str(pids)}
    words = ["--mode", "replay", "--bag", tmp_path, "--log", tmp_path, "--", "bash", "-c", COMMAND]
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

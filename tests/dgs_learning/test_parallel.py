"""Where jobs run: a dask cluster by its address, and engines that are refused."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dgs_description.errors import ErrorCode, JointNameError
from dgs_learning.parallel import Engine
from tests.support.refused import refused


@pytest.mark.slow
def test_a_running_cluster_is_used_by_its_address() -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster:
        engine = Engine(0, "dask", cluster.scheduler_address)
        processes = set(engine.run(os.getpid, [()] * 4))
    assert processes and os.getpid() not in processes


@pytest.mark.slow
def test_the_command_starts_a_cluster_of_its_own(tmp_path: Path) -> None:
    words = ("validate", "--count", "1", "--backend", "dask", "--workers", "1", "--folder", tmp_path)
    ran = subprocess.run(
        [Path(sys.executable).parent / "dgs", *words], capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
    assert "1 of 1" in " ".join(ran.stdout.split())


def _refuse(what: str) -> None:
    raise JointNameError(f"{what} is no joint")


def test_a_refusal_in_another_process_arrives_with_its_code() -> None:
    with refused(ErrorCode.JOINT_NAMES, "thumb is no joint"):
        list(Engine(2).run(_refuse, [("thumb",)] * 2))

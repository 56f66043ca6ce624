"""Where jobs run: a dask cluster by its address, and engines that are refused."""

from __future__ import annotations

import os

import pytest

from dgs_learning.parallel import Engine


@pytest.mark.slow
def test_a_running_cluster_is_used_by_its_address() -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        engine = Engine(0, "dask", cluster.scheduler_address)
        processes = set(engine.run(os.getpid, [()] * 4))
    assert processes and os.getpid() not in processes


def test_unknown_engine_and_useless_address_are_refused() -> None:
    with pytest.raises(ValueError, match="loky, dask"):
        Engine(1, "slurm")
    with pytest.raises(ValueError, match="stays on this machine"):
        Engine(1, "loky", "tcp://somewhere:8786")

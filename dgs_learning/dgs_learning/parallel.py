"""Runs many jobs through joblib on this machine's cores or on a cluster: loky, dask or ray, chosen by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from joblib import Parallel, delayed, parallel_config

BACKENDS = ("loky", "dask", "ray")


def process_count(wanted: int) -> int:
    """How many processes to start: `wanted`, or one per core that this process may use where that is 0."""
    return wanted or len(os.sched_getaffinity(0))


@dataclass(frozen=True)
class Engine:
    """Where jobs run.

    Attributes:
        workers: processes on this machine; a cluster that is given by its address has its own number.
        backend: "loky" (processes of joblib), "dask" or "ray".
        cluster: address of a running dask scheduler (tcp://host:8786) or ray head; empty = one on this machine.
    """

    workers: int
    backend: str = "loky"
    cluster: str = ""

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise ValueError(f"no backend named {self.backend!r}; there are {', '.join(BACKENDS)}")
        if self.cluster and self.backend == "loky":
            raise ValueError(
                f"the cluster {self.cluster} needs the backend dask or ray, loky stays on this machine"
            )

    def run(
        self, function: Callable[..., Any], jobs: Iterable[tuple[Any, ...]], ordered: bool = False
    ) -> Iterator[Any]:
        """Results of `function(*job)` for every job, as they come or in the order of the jobs.

        Jobs are taken from the iterable only a little ahead of the work, and results are handed on at once, so that
        a caller that writes each one loses nothing when it is killed.
        """
        with _backend(self):
            parallel = Parallel(
                n_jobs=-1 if self.cluster else self.workers,
                return_as="generator" if ordered else "generator_unordered",
                pre_dispatch="2*n_jobs",
                batch_size=1,
            )
            yield from parallel(delayed(function)(*job) for job in jobs)


@contextmanager
def _backend(engine: Engine) -> Iterator[None]:
    """joblib's backend for the time of the block, with a cluster on this machine if none is given.

    Raises:
        ValueError: the engine is not installed.
    """
    if engine.backend == "loky":
        with parallel_config(backend="loky"):
            yield
        return
    package, advice, start = _CLUSTERS[engine.backend]
    if find_spec(package) is None:
        raise ValueError(f"the backend {engine.backend} needs the package {package}: {advice}")
    with start(engine), parallel_config(backend=engine.backend):
        yield


@contextmanager
def _dask(engine: Engine) -> Iterator[None]:
    from distributed import Client, LocalCluster

    if engine.cluster:
        with Client(engine.cluster):
            yield
        return
    # One thread per process: PyBullet worlds of one process would wait for one another.
    with (
        LocalCluster(n_workers=engine.workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster),
    ):
        yield


@contextmanager
def _ray(engine: Engine) -> Iterator[None]:
    import ray
    from ray.util.joblib import register_ray

    register_ray()
    if engine.cluster:
        ray.init(address=engine.cluster)
    else:
        ray.init(num_cpus=engine.workers, include_dashboard=False)
    try:
        yield
    finally:
        ray.shutdown()


_CLUSTERS = {
    "dask": ("distributed", "pip install distributed", _dask),
    "ray": ("ray", "pip install ray", _ray),
}
"""Per backend the package it needs, how to get it, and what starts it."""

"""Runs many jobs through joblib: on this machine's cores (loky), or on a cluster (dask)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any, Literal

from joblib import Parallel, delayed, parallel_config

from dgs_description.errors import DgsError, ErrorCode


@dataclass(frozen=True)
class Engine:
    """Where jobs run.

    Attributes:
        workers: processes on this machine, 0 = one per core; a cluster that is given by its address has its own number.
        backend: "loky" (processes of joblib) or "dask".
        cluster: address of a running dask scheduler (tcp://host:8786); empty = one on this machine.
    """

    workers: int
    backend: Literal["loky", "dask"] = "loky"
    cluster: str = ""

    def __post_init__(self) -> None:
        if self.cluster and self.backend == "loky":
            raise DgsError(
                ErrorCode.REQUEST_INVALID,
                f"the cluster {self.cluster} needs the backend dask, loky stays on this machine",
            )

    def run(
        self, function: Callable[..., Any], jobs: Iterable[tuple[Any, ...]], ordered: bool = False
    ) -> Iterator[Any]:
        """Results of `function(*job)` for every job, as they come or in the order of the jobs.

        Jobs are taken from the iterable only a little ahead of the work, and results are handed on at once, so that
        a caller that writes each one loses nothing when it is killed.

        Raises:
            DgsError: REQUEST_INVALID: dask is not installed.
        """
        with self._client(), parallel_config(backend=self.backend):
            workers = -1 if self.cluster else self.workers or -1
            order = "generator" if ordered else "generator_unordered"
            parallel = Parallel(workers, return_as=order, pre_dispatch="2*n_jobs", batch_size=1)
            yield from parallel(delayed(function)(*job) for job in jobs)

    def _client(self) -> AbstractContextManager[Any]:
        """The connection to dask's scheduler, which is started here if none is given."""
        if self.backend == "loky":
            return nullcontext()
        try:
            from distributed import Client
        except ImportError as error:
            missing = "the backend dask needs a package: pip install distributed"
            raise DgsError(ErrorCode.REQUEST_INVALID, missing) from error
        if self.cluster:
            return Client(self.cluster)
        # One thread per process: PyBullet worlds of one process would wait for one another.
        return Client(n_workers=self.workers or None, threads_per_worker=1, dashboard_address="127.0.0.1:0")

"""One thread that does jobs one after the other, from a queue of limited length."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

Job = Callable[[], None]


class SerialWorker:
    """Runs jobs in the order they came. A job handles its own exceptions."""

    def __init__(self, name: str, capacity: int):
        """Start the thread.

        Args:
            name: of the thread.
            capacity: jobs that may wait.
        """
        self._jobs: queue.Queue[Job | None] = queue.Queue(capacity)
        self._stopping = threading.Event()
        # No daemon: the interpreter must not be taken apart while the thread is inside torch, that aborts the process.
        self._thread = threading.Thread(target=self._run, name=name)
        self._thread.start()

    def submit(self, job: Job) -> bool:
        """Queue a job; False if the queue is full or the worker was stopped."""
        if self._stopping.is_set():
            return False
        try:
            self._jobs.put_nowait(job)
        except queue.Full:
            return False
        return True

    def stop(self, timeout: float) -> bool:
        """Let the running job end, forget the others; True if it ended within `timeout` [s]."""
        self._stopping.set()
        try:
            self._jobs.put_nowait(None)
        except queue.Full:
            pass  # the thread looks at `_stopping` before its next job
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._stopping.is_set():
            job = self._jobs.get()
            if job is not None and not self._stopping.is_set():
                job()

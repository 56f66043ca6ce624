"""One thread, one job after the other."""

from __future__ import annotations

import threading

from dgs_grasp_planner.serial_worker import SerialWorker


def test_order_capacity_and_stop() -> None:
    worker = SerialWorker("test", 2)
    started, go, done = threading.Event(), threading.Event(), []

    def first() -> None:
        started.set()
        go.wait(5.0)
        done.append(1)

    assert worker.submit(first)
    assert started.wait(5.0)
    assert worker.submit(lambda: done.append(2))
    finished = threading.Event()
    assert worker.submit(finished.set)
    assert not worker.submit(lambda: done.append(9)), "the queue takes two"
    go.set()
    assert finished.wait(5.0)
    assert done == [1, 2]
    assert worker.stop(5.0)
    assert not worker.submit(lambda: done.append(9))


def test_stop_forgets_what_waits() -> None:
    worker = SerialWorker("test", 4)
    started, go, done = threading.Event(), threading.Event(), []

    def first() -> None:
        started.set()
        go.wait(5.0)

    worker.submit(first)
    assert started.wait(5.0)
    worker.submit(lambda: done.append(9))
    assert not worker.stop(0.01), "the first job still runs"
    go.set()
    assert worker.stop(5.0)
    assert done == []

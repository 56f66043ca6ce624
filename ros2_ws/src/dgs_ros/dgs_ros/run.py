"""Runs a node as a process that ends cleanly on signals: `run(CameraNode)`."""

from __future__ import annotations

import faulthandler
import logging
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import rclpy
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dgs_description import malloc
from dgs_description.errors import DgsError, ErrorCode
from dgs_ros.base_node import DgsNode
from dgs_ros.diagnostics import Level
from dgs_ros.shared_memory import remove_abandoned

EXIT_CLEAN, EXIT_CRASH, EXIT_REFUSED = 0, 1, 2
"""Exit codes: asked to end, an exception nobody handled, refused to start (parameters, files, devices)."""

GRACE = 4.0
"""How long a node may take to end after a signal before the process ends itself with exit code 0 [s]."""
_RESULTS = 2.5
"""So much of it the running goals get to end and to send their results [s]."""
STUCK = 9.0
"""A process that the middleware does not let end has exit code 1 and a traceback after so long [s].

Fast DDS may lock itself up while it takes an endpoint of another process out of its lists (its issue 6502), and holds
Python's lock meanwhile: no thread of Python could end the process.
"""
HELD = 30.0
"""The same happens to a process that nobody asked to end, once Python's lock has been held, or Fast DDS's timer thread
has stood still, for so long [s]: locked up, a node that seems well is missed by all others."""
BEATS = 6
"""So many looks in that time."""
_alarm = threading.Lock()
"""Held while faulthandler's alarm, of which a process has one, is set."""
ARENAS = 2
"""Heaps of glibc in a process. Its default, 8 per core, lets each of a node's threads keep the largest cloud that it
has worked on: an arm executor grew by 30 MiB at a time for an hour."""


def run(factory: Callable[[], DgsNode], args: Sequence[str] | None = None) -> NoReturn:
    """Build a node, serve until SIGINT, SIGTERM or SIGHUP, end the process.

    Shared memory that killed processes have left is removed first.

    An exception in a callback is logged and reported as ERROR, and the node goes on serving. After a signal `stopping`
    is set, the running goals end, and `close()` is called; what still runs after `GRACE` seconds is abandoned, so that
    the process ends with exit code 0 in any case.

    Ends the process: exit code 0 after a signal, 2 if the factory or `prepare` refused with a `DgsError`, 1 if the
    node broke. `args` is the command line; None = sys.argv.
    """
    asked = _watch_signals()
    malloc.mallopt(malloc.ARENA_MAX, ARENAS)  # before the threads: a heap that one has got it keeps
    remove_abandoned()
    try:
        init_ros(args, SignalHandlerOptions.NO)
        node = factory()
    except DgsError as error:
        _refuse(error)
    except Exception:
        traceback.print_exc()
        _end(EXIT_CLEAN if asked.is_set() else EXIT_CRASH)
    logging.getLogger().addHandler(_ToRos(node))
    spinners: dict[Executor, threading.Thread] = {}
    for executor in node.make_executors():
        spinners[executor] = threading.Thread(target=_spin, args=(executor, node), name="spin", daemon=True)
        spinners[executor].start()
    threading.Thread(target=_prepare, args=(node,), name="prepare", daemon=True).start()
    threading.Thread(target=_beat, args=(asked,), name="heartbeat", daemon=True).start()
    while not asked.wait(0.5) and all(spinner.is_alive() for spinner in spinners.values()):
        pass
    code = EXIT_CLEAN if asked.is_set() else EXIT_CRASH
    if code == EXIT_CRASH:
        node.get_logger().error("the ROS context was shut down from inside; ending")
    _shut_down(node, spinners)
    _end(code)


class _ToRos(logging.Handler):
    """Says as the node, on /rosout too, what modules without ROS warn of by Python's logging."""

    def __init__(self, node: Node) -> None:
        super().__init__(logging.WARNING)
        self._ros = node.get_logger()

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno >= logging.ERROR:
            self._ros.error(self.format(record))
        else:  # a line of its own: rclpy lets none change its severity
            self._ros.warning(self.format(record))


def init_ros(args: Sequence[str] | None, signals: SignalHandlerOptions | None = None) -> None:
    """As `rclpy.init`. Raises DgsError PARAMETER_INVALID where ROS does not take what follows `--ros-args`."""
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=signals)
    except RuntimeError as error:
        said = re.sub(r"failed to initialize rcl: |\s*, at \S+:\d+", "", str(error))
        said = re.sub(r"\. Error: (error not set|Expected lexeme).*", "", said)
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"ROS refuses: {said}") from error


def _refuse(error: DgsError) -> NoReturn:
    print(f"cannot start: {error.message} (code {int(error.code)})", file=sys.stderr, flush=True)
    _end(EXIT_REFUSED)


def _watch_signals() -> threading.Event:
    """An event that SIGINT, SIGTERM or SIGHUP sets, even while the main thread is inside a long C call."""
    received = threading.Event()
    read_end, write_end = os.pipe()
    os.set_blocking(write_end, False)
    endings = {signal.SIGINT, signal.SIGTERM}
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup: the terminal may go
        endings.add(signal.SIGHUP)
    for number in endings:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)

    def watch() -> None:
        while not endings & set(os.read(read_end, 64)):
            pass
        with _alarm:
            received.set()
            faulthandler.dump_traceback_later(STUCK, exit=True)
        # Callbacks or libraries may hold the process; nobody who pressed Ctrl-C wants to wait for them.
        threading.Event().wait(GRACE)
        _end(EXIT_CLEAN)

    threading.Thread(target=watch, name="signals", daemon=True).start()
    return received


def _beat(asked: threading.Event) -> None:
    """Put the alarm off, as long as this thread gets Python's lock and the middleware's timers go on."""
    before, standing = -1, 0
    while not asked.is_set():
        with _alarm:
            if not asked.is_set():
                faulthandler.dump_traceback_later(HELD, exit=True)
        asked.wait(HELD / BEATS)
        now = timer_wakes(os.getpid())
        standing = standing + 1 if now == before != 0 else 0
        before = now
        if standing >= BEATS and not asked.is_set():
            print(f"the middleware has stood still for {HELD:g} s: it has locked itself up", file=sys.stderr)
            faulthandler.dump_traceback()
            _end(EXIT_CRASH)


def timer_wakes(pid: int) -> int:
    """How often Fast DDS's timer thread has woken up: some four times a second; 0 where there is none to be seen."""
    wakes = 0
    for task in Path(f"/proc/{pid}/task").glob("*"):
        with suppress(OSError):
            if (task / "comm").read_text().startswith("dds.ev"):
                found = re.search(r"\nvoluntary_ctxt_switches:\s*(\d+)", (task / "status").read_text())
                wakes += int(found[1]) if found else 0
    return wakes


def _prepare(node: DgsNode) -> None:
    try:
        node.prepare()
    except DgsError as error:
        if not node.stopping.is_set():
            _refuse(error)
    except Exception as error:
        if not node.stopping.is_set():
            node.get_logger().fatal(f"the node cannot serve\n{traceback.format_exc()}")
            node.report(Level.ERROR, f"the node cannot serve: {error}")
    else:
        node.get_logger().info("ready")


def _spin(executor: Executor, node: DgsNode) -> None:
    while not node.stopping.is_set() and node.context.ok():
        try:
            executor.spin()
        except ExternalShutdownException:
            return
        except Exception as error:
            if node.stopping.is_set() or not node.context.ok():
                return
            node.get_logger().error(f"unhandled exception in a callback\n{traceback.format_exc()}")
            sentence = f"unhandled {type(error).__name__} in a callback: {error}"
            node.report_event(Level.ERROR, sentence, "callbacks")


def _shut_down(node: DgsNode, spinners: dict[Executor, threading.Thread]) -> None:
    node.stopping.set()
    end = time.monotonic() + _RESULTS
    while node.unfinished_goals and time.monotonic() < end:
        time.sleep(0.01)
    try:
        node.close()
    except Exception:
        traceback.print_exc()
    # Callbacks that still work would lose the handles under their feet: then leave without taking the node apart.
    for executor, spinner in spinners.items():
        executor.shutdown()  # returns at once (Jazzy), whatever still runs
        if not executor._work_tracker.wait(1.0):
            return
        spinner.join(0.5)
        if spinner.is_alive():
            return
    destroy(node)
    rclpy.try_shutdown()


def destroy(node: Node) -> None:
    """Destroy a node with its action servers and clients, which rclpy leaves.

    Each of them would keep the DDS participant, and with it 64 MiB of shared memory that outlive the process.
    """
    for waitable in list(node.waitables):
        waitable.destroy()
    node.destroy_node()


def _end(code: int) -> NoReturn:
    """End the process at once.

    Not by sys.exit: taking the interpreter and its libraries apart takes seconds on a busy machine, nothing can cut it
    short, and a second Ctrl-C meanwhile would find no handler any more and spoil the exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            pass
    os._exit(code)

"""What nodes share: checked parameters, /diagnostics, an action client, and a `run` that ends cleanly on signals.

class CameraNode(DgsNode[CameraParameters]):
    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("camera_node", CameraParameters, **node_arguments)

def main(args: list[str] | None = None) -> None:
    run(CameraNode, args)
"""

from __future__ import annotations

import dataclasses
import math
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NoReturn, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from dgs_description.errors import DgsError
from dgs_ros.diagnostics import EVENT_LASTS, Level, StatusBoard
from dgs_ros.parameters import constraints_of, from_values, parameter

P = TypeVar("P")

EXIT_CLEAN, EXIT_CRASH, EXIT_REFUSED = 0, 1, 2
"""Exit codes: asked to end, an exception nobody handled, refused to start (parameters, files, devices)."""

GRACE = 3.0
"""How long a node may take to end after a signal before the process ends itself with exit code 0 [s]."""

_ROS_PARAMETERS = ("use_sim_time", "start_type_description_service")
_ROS_PARAMETER_PREFIX = "qos_overrides."


@dataclasses.dataclass(frozen=True)
class CommonParameters:
    """Parameters that every node has besides its own."""

    executor_threads: int = parameter(
        4, "Threads that run callbacks which may take long.", minimum=2, maximum=64
    )


# rclpy's MultiThreadedExecutor looks at every entity of the node, hands the callback to another thread and looks at
# every entity again: with /clock and joint states at 100 Hz and more, that alone fills a core. So the few entities that
# bring messages all the time have a thread of their own, and the pool sleeps meanwhile.


class StreamGroup(ReentrantCallbackGroup):
    """Callbacks that come often and return at once. They run one after another in the thread of a `StreamExecutor`."""


class StreamExecutor(SingleThreadedExecutor):
    """Runs the callbacks of a node's stream groups, and only those."""

    def __init__(self, node: Node) -> None:
        """Serve `node`, which belongs to another executor at the same time."""
        super().__init__(context=node.context)
        self._node = node

    def get_nodes(self) -> list[Node]:
        """The one node."""
        return [self._node]

    def can_execute(self, entity: Any) -> bool:
        """Whether it is a stream that does not run yet."""
        return isinstance(entity.callback_group, StreamGroup) and super().can_execute(entity)


class PoolExecutor(MultiThreadedExecutor):
    """Runs all other callbacks in a pool of threads, so that they may take their time."""

    def can_execute(self, entity: Any) -> bool:
        """Whether it is not a stream, and its callback group lets it run."""
        return not isinstance(entity.callback_group, StreamGroup) and super().can_execute(entity)


class SafeActionClient(ActionClient):
    """An action client that may be used from any thread while another one spins its node.

    rclpy (Jazzy) writes down what it waits for only after the request is on its way. A server that answers at once is
    then "unexpected", its answer is dropped, and the goal runs on without anybody knowing. Here an answer waits until
    the request that is being sent is written down.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        """Take the arguments of `ActionClient`."""
        self._sending = threading.RLock()
        super().__init__(*args, **keywords)

    def send_goal_async(self, *args: Any, **keywords: Any) -> Any:
        """Send a goal, as `ActionClient.send_goal_async`."""
        with self._sending:
            return super().send_goal_async(*args, **keywords)

    @staticmethod
    def cancel_when_accepted(sent: Any) -> None:
        """Cancel the goal of a `send_goal_async` future as soon as it is accepted: nobody waits for it any more."""

        def cancel(accepted: Any) -> None:
            handle = accepted.result()
            if handle is not None and handle.accepted:
                handle.cancel_goal_async()

        sent.add_done_callback(cancel)

    def _get_result_async(self, goal_handle: Any) -> Any:
        with self._sending:
            return super()._get_result_async(goal_handle)

    def _cancel_goal_async(self, goal_handle: Any) -> Any:
        with self._sending:
            return super()._cancel_goal_async(goal_handle)

    async def execute(self, taken_data: Any) -> None:
        """Hand out the answers that have come (called by the executor)."""
        with self._sending:
            pass
        await super().execute(taken_data)


class DgsNode(Node, Generic[P]):
    """A node whose parameters arrive as an instance of a frozen dataclass, and which publishes /diagnostics.

    Attributes:
        parameters: the values, checked; they do not change while the node runs (a set request is refused).
        common: parameters that all nodes have.
        stopping: set when the node is asked to end; loops in own threads watch it.
        streams: callback group of subscriptions that name none, /clock among them: their callbacks must return at once.
    """

    def __init__(self, name: str, parameters: type[P], **node_arguments: Any) -> None:
        """Declare and check the parameters.

        Args:
            name: of the node.
            parameters: dataclass with fields made by `dgs_ros.parameters.parameter`.
            node_arguments: passed on to `rclpy.node.Node` (context, parameter_overrides, ...).

        Raises:
            ParameterError: an unknown name, a wrong type or a value out of bounds was given.
        """
        self.streams = StreamGroup()
        self._stream_executor: StreamExecutor | None = None
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **node_arguments)
        self.stopping = threading.Event()
        try:
            self.common, self.parameters = self._read_parameters(parameters)
        except DgsError:
            self.destroy_node()
            raise
        self._board = StatusBoard(self.get_fully_qualified_name()[1:])
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # A steady timer: the node must report also while simulated time stands still.
        self._diagnostics_timer = self.create_timer(
            1.0,
            self._publish_diagnostics,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def create_subscription(self, *args: Any, **keywords: Any) -> Subscription:
        """As `Node.create_subscription`; without a callback group of its own it is one of the `streams`."""
        keywords["callback_group"] = keywords.get("callback_group") or self.streams
        subscription: Subscription = super().create_subscription(*args, **keywords)
        if self._stream_executor is not None:
            self._stream_executor.wake()
        return subscription

    def make_executors(self) -> list[Executor]:
        """The executors that run the node's callbacks; each wants a thread."""
        self._stream_executor = StreamExecutor(self)
        pool = PoolExecutor(self.common.executor_threads, context=self.context)
        pool.add_node(self)
        return [self._stream_executor, pool]

    def report(self, level: Level, message: str, component: str = "", **values: object) -> None:
        """Set the node's diagnostic status; it is published once a second, and at once when the level changes.

        Args:
            level: OK, WARN, ERROR or STALE.
            message: one sentence.
            component: part of the node that it is about; every component has its own status.
            values: figures that go with it.
        """
        self._put_status(level, message, component, math.inf, values)

    def report_event(self, level: Level, message: str, component: str = "", **values: object) -> None:
        """As `report`, of a single event whose end nobody reports: it is over after `EVENT_LASTS`."""
        self._put_status(level, message, component, EVENT_LASTS, values)

    def _put_status(
        self, level: Level, message: str, component: str, lasts: float, values: Mapping[str, object]
    ) -> None:
        if self._board.put(level, message, component, lasts, values):
            self._publish_diagnostics()

    def close(self) -> None:
        """Stop threads, close devices; override it. Called once when the node is to end, before it is destroyed."""

    def _publish_diagnostics(self) -> None:
        statuses = self._board.statuses()
        if not statuses or not self.context.ok():
            return
        array = DiagnosticArray(status=statuses)
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def _read_parameters(self, kind: type[P]) -> tuple[CommonParameters, P]:
        # Overrides were declared as they came; take them back, check them, declare them again with what they are.
        given = {
            name: value.value
            for name, value in self.get_parameters_by_prefix("").items()
            if name not in _ROS_PARAMETERS and not name.startswith(_ROS_PARAMETER_PREFIX)
        }
        common_names = {field.name for field in dataclasses.fields(CommonParameters)}
        common = from_values(CommonParameters, {k: v for k, v in given.items() if k in common_names})
        own = from_values(kind, {k: v for k, v in given.items() if k not in common_names})
        for name in given:
            self.undeclare_parameter(name)
        for instance in (common, own):
            for field in dataclasses.fields(instance):  # type: ignore[arg-type]
                value = getattr(instance, field.name)
                self.declare_parameter(field.name, value, _descriptor(field, value), ignore_override=True)
        return common, own


def _descriptor(field: dataclasses.Field, value: object) -> ParameterDescriptor:
    """What `ros2 param describe` shows."""
    constraints = constraints_of(field)
    descriptor = ParameterDescriptor(
        description=constraints.description,
        additional_constraints=constraints.text(),
        read_only=True,
        # An empty list has no type of its own in ROS.
        dynamic_typing=value == (),
        type=Parameter.Type.NOT_SET.value
        if value == ()
        else Parameter.Type.from_parameter_value(value).value,
    )
    low, high = constraints.minimum, constraints.maximum
    if low is not None and high is not None:
        if isinstance(value, int) and not isinstance(value, bool):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=0)]
        elif isinstance(value, float):
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
    return descriptor


def run(factory: Callable[[], DgsNode], args: Sequence[str] | None = None) -> NoReturn:
    """Build a node, serve until SIGINT or SIGTERM, end the process.

    Streams run in a `StreamExecutor`, other callbacks in a `PoolExecutor` with `executor_threads` threads. An exception
    in a callback is logged and reported as ERROR, and the node goes on serving. After a signal `stopping` is set and
    `close()` is called; what still runs after `GRACE` seconds is abandoned, so that the process ends with exit code 0
    in any case.

    Args:
        factory: makes the node; a `DgsError` from it is a refusal to start.
        args: command line; None = sys.argv.

    Ends the process: exit code 0 after a signal, 2 if the node refused to start, 1 if it broke.
    """
    signals = _Signals()
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
        node = factory()
    except DgsError as error:
        print(f"cannot start: {error.message} (code {int(error.code)})", file=sys.stderr, flush=True)
        _end(EXIT_REFUSED)
    except Exception:
        traceback.print_exc()
        if signals.received.is_set():
            _end(EXIT_CLEAN)
        _end(EXIT_CRASH)
    spinners = {
        executor: threading.Thread(target=_spin, args=(executor, node), name="spin", daemon=True)
        for executor in node.make_executors()
    }
    for spinner in spinners.values():
        spinner.start()
    node.get_logger().info("ready")
    while not signals.received.wait(0.5) and all(spinner.is_alive() for spinner in spinners.values()):
        pass
    asked = signals.received.is_set()
    if not asked:
        node.get_logger().error("the ROS context was shut down from inside; ending")
    _shut_down(node, spinners)
    _end(EXIT_CLEAN if asked else EXIT_CRASH)


class _Signals:
    """Sees SIGINT and SIGTERM in a thread of its own, even while the main thread is inside a long C call."""

    THREAD = "signals"

    def __init__(self) -> None:
        self.received = threading.Event()
        read_end, write_end = os.pipe()
        os.set_blocking(write_end, False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: None)
        signal.set_wakeup_fd(write_end, warn_on_full_buffer=False)
        threading.Thread(target=self._watch, args=(read_end,), name=self.THREAD, daemon=True).start()

    def _watch(self, read_end: int) -> None:
        endings = {int(signal.SIGINT), int(signal.SIGTERM)}
        while not endings & set(os.read(read_end, 64)):
            pass
        self.received.set()
        # Callbacks or libraries may hold the process; nobody who pressed Ctrl-C wants to wait for them.
        threading.Event().wait(GRACE)
        _flush()
        os._exit(EXIT_CLEAN)


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
    try:
        node.close()
    except Exception:
        traceback.print_exc()
    # Callbacks that still work would lose the handles under their feet: then leave without taking the node apart.
    for executor, spinner in spinners.items():
        executor.shutdown()  # returns at once (Jazzy), whatever still runs
        if not executor._work_tracker.wait(GRACE / 2):
            return
        spinner.join(1.0)
        if spinner.is_alive():
            return
    node.destroy_node()
    rclpy.try_shutdown()


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            pass


def _end(code: int) -> NoReturn:
    """End the process at once.

    Not by sys.exit: taking the interpreter and its libraries apart takes seconds on a busy machine, nothing can cut it
    short, and a second Ctrl-C meanwhile would find no handler any more and spoil the exit code.
    """
    _flush()
    os._exit(code)
